"""Reading logs: whole, by their results, and damaged ones."""
