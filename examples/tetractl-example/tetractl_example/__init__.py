"""An optimiser and a camera for tetractl."""
