"""Verify logs of trials by repeating their simulations or their decisions."""
