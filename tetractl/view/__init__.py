"""Views of a trial: live view and player in a terminal, and figures."""
