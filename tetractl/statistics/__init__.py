"""Results: batches of trials opened, described, compared, and laid out as tables."""
