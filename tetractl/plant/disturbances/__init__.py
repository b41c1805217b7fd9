"""Disturbances of the simulated plant: one file each, named in `tetractl.core.registries`."""
