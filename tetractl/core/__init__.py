"""Types that all packages share: poses, commands, plans, trials, protocols, clock, errors."""
