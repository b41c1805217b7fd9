"""Disturbances of the simulated plant, by what they disturb; named in `tetractl.core.registries`."""
