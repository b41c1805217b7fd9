"""Search for a sequence of signals: its cost, the optimisers, and when they stop."""
