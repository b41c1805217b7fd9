"""The plants: simulation and lab."""
