"""Writing logs."""
