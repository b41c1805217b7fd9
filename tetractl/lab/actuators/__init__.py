"""Actuators, which steer robots by the common direction; one package or file per device."""
