"""The vocabulary of all packages: poses, commands, plans, trials, protocols, clock, errors."""
