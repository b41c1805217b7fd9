"""Helpers for tests that need tetractl-microscope."""
