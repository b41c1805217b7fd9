"""Shapes of obstacles: one file each, named in `core.registries`."""
