"""An optimizer and a camera for tetractl."""
