"""The compiled Kalman filters that learn how robots move, and the choice between them."""
