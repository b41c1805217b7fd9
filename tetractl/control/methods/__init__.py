"""The controllers: the paper's Algorithm 2, our model predictive control, and simpler methods."""
