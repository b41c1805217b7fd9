"""The optimisers: one file each, with its section of the spec and its search."""
