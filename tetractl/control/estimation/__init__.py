"""Estimation: where the robots are, how each of them turns, and how late commands act."""
