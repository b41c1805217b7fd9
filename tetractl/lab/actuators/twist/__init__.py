"""Robots on two wheels that take lines of text, over a serial port or UDP."""
