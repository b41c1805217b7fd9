"""Studies: many arms of trials in the same worlds, run anywhere, gathered in one table."""
