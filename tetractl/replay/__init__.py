"""Replay: play a recorded trial back, and verify it by re-computation."""
