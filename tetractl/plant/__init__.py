"""The plants of a trial, which carry out its commands: simulations, and the real lab."""
