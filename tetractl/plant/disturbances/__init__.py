"""Disturbances of the simulated plant, by what they disturb; see `core.registries`."""
