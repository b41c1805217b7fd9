"""Views in a terminal."""
