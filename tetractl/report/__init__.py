"""The report: one HTML file that shows trials and their statistics without a network."""
