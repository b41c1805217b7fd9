"""Disturbances of the simulated plant, named in `core.registries`."""
