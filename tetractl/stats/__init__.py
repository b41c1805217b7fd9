"""How good a batch of trials is."""
