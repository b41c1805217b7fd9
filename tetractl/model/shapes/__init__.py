"""Shapes of obstacles: one file each, named in `experiment.kinds`."""
