"""Emulated OptiTrack cameras: a Motive server over UDP."""
