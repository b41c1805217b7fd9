"""Views of a trial for people: a live view and a player in a terminal, figures, and videos."""
