"""The lab's wires: cameras in, radio out."""
