"""Specs as YAML text: parsing with locations, overrides, upgrades, and plain error messages."""
