"""Specs as YAML text: parsing with locations, and error messages."""
