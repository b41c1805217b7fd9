"""Motions of a robot under the common direction: one file each, named in `core.registries`."""
