"""Motions of a robot under the common direction; each has a file named in `core.registries`."""
