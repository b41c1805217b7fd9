"""Cells seen through a microscope: pictures to the planar poses of cells."""
