"""Model predictive control, Algorithm 2, and the optimisers it can use, Algorithm 1 among them."""
