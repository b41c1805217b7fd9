"""Replay of recorded trials, and their verification by re-computation."""
