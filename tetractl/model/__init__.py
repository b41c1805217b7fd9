"""How robots move, and the obstacles between them."""
