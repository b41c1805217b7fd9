"""Studies: trials of many variants of a spec ("arms") with paired seeds, in one table."""
