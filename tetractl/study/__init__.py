"""Run studies: trials of many variants of a spec ("arms") with paired seeds."""
