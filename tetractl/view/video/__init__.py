"""A trial as a film: its pictures, and the files they become."""
