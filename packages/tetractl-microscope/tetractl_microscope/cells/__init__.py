"""Measures planar poses of cells from the images of a microscope."""
