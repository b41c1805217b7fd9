"""Statistics of trials: open batches, describe and compare them, and lay them out as tables."""
