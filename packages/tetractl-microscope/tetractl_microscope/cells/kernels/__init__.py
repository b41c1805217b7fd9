"""Compiled parts of the tracking of cells."""
