"""Helpers for tests that need tetractl-emulator."""
