"""Controllers: Algorithm 2 of the paper, model predictive control, and simpler methods."""
