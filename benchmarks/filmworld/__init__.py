"""Synthetic films of swimming cells by two renderers that share no code, and scores of trackers."""
