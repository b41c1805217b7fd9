"""What all packages share: poses, commands, plans, trials, protocols, kinds, clock, errors."""

__version__ = "0.1.0"
