"""Actuators, which turn a direction into the motion of robots: one package or file each."""
