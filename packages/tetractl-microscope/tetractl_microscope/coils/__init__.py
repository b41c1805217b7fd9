"""Steers cells by the magnetic field of two orthogonal coil pairs."""
