"""Kinds of obstacles, each a section of a spec; each has a file named in `core.registries`."""
