"""Shapes of obstacles; each has a file named in `core.registries`."""
