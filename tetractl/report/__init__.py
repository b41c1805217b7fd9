"""The report of experiments: one HTML file that shows trials and statistics, without a network."""
