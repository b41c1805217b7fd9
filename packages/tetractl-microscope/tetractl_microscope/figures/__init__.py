"""Figures of the cells in a film; each is drawn by a function named in `registries`."""
