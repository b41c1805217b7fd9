"""What all packages share: poses, commands, plans, trials, protocols, kinds, clock, errors."""
