"""Identifies the turning rates, speeds and dead time of robots from recorded trials."""
