"""Cameras, which track the robots; one package or file per device."""
