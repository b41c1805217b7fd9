"""Planar poses of cells from a microscope's pictures."""
