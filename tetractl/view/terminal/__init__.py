"""Views in a terminal: the live view of running trials, the player of logs, and progress bars."""
