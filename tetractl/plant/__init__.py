"""The plants that receive a trial's commands: simulations and the lab."""
