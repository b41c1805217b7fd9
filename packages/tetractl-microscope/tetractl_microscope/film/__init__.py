"""Analyses recorded films of cells: tracks, speeds and each cell's response to the field."""
