"""An emulated camera above tags: a renderer of pictures and a network camera."""
