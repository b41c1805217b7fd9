"""Records and protocols that all packages share: poses, commands, plans, trials, clock, errors."""

__version__ = "0.1.0"
