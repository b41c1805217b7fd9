"""Warnings of specs that are valid but cannot work, or not as they were meant."""
