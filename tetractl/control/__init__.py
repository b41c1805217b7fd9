"""PSO inside model predictive control, Algorithms 1 and 2."""
