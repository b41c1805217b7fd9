"""Statistics of a batch of trials."""
