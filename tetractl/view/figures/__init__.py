"""Figures of trials and batches, and functions that they share."""
