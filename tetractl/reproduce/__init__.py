"""Published papers reproduced: their figures next to ours, each with a verdict."""
