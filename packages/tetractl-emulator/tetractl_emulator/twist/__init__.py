"""Emulated robots that take lines of text."""
