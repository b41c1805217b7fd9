"""Reads logs: complete logs, only their results, and damaged logs."""
