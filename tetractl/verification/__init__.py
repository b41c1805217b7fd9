"""Verification of recorded trials by re-computation."""
