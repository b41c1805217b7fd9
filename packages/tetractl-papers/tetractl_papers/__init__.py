"""Reproduces the figures and claims of published papers, and prints them next to our results."""
