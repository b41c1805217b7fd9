"""An emulated camera that looks at tags: a renderer of pictures and a network camera."""
