"""Chooses which cells of a dish become the robots of a trial: `robots: {choose: N, ...}`."""
