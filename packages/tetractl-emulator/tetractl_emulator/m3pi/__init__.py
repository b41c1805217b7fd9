"""Emulated m3pi robots, and the emulated XBee radio through which they receive commands."""
