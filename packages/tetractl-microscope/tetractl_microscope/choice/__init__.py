"""Trials that choose their robots among the cells of a dish: `robots: {choose: N, ...}`."""
