"""An emulated camera above robots with tags: a renderer of pictures behind a network camera."""
