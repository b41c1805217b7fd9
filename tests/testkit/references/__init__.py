"""Slow reference implementations, to compare the product with."""
