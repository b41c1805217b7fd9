"""Emulated m3pi robots behind an emulated XBee on a pseudo-terminal."""
