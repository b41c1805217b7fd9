"""An emulated dish of cells, and synthetic images of it."""
