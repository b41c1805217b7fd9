"""Controllers: model predictive control (Algorithm 2), its optimisers, and simpler methods."""
