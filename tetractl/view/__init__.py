"""Views of a trial: the terminal's live view and player, and the paper's figures."""
