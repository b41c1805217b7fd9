"""Cameras: what tracks the robots, one package or file each."""
