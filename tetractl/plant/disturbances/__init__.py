"""Disturbances of the simulated plant: one file each, named in `tetractl.experiment.kinds`."""
