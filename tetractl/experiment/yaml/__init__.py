"""Specs as YAML text: parsing with places, overrides, upgrades, problems in plain words."""
