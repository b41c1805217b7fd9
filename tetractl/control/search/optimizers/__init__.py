"""The optimisers; each has a file with its section of the spec and its search."""
