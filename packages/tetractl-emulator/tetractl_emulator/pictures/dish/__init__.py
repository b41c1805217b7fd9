"""An emulated dish of cells, and its synthetic pictures."""
