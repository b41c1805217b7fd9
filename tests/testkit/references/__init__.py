"""Slow implementations of what the product computes, to compare it with."""
