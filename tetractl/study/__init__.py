"""Studies: many arms of trials with paired seeds, run anywhere, collected in one table."""
