"""The plants, in which robots receive commands: simulations and the lab."""
