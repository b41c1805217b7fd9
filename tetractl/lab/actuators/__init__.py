"""Actuators: what turns a direction into the motion of robots, one package or file each."""
