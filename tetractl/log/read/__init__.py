"""Read logs of trials: complete logs, only their results, or what is left of damaged logs."""
