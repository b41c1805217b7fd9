"""Finds and tracks swimming cells in the images of a microscope, and measures their poses."""
