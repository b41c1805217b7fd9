"""Emulated robots that receive commands as lines of text."""
