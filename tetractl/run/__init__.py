"""The trial loop, and batches of trials."""
