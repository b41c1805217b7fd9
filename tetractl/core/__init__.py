"""Records and protocols that all parts share: poses, commands, plans, trials, clock, errors."""

__version__ = "0.1.0"
