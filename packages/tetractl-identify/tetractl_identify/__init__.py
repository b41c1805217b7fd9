"""Identifies robots and dead time from recorded trials, with intervals."""
