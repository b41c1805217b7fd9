"""Specs as YAML text: parsing with locations, renamed keys, and error messages."""
