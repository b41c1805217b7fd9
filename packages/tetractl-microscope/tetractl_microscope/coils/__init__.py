"""A magnetic field from two orthogonal coil pairs: the common direction of the paper's cells."""
