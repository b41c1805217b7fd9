"""The folder of two short trials, for all tests here."""

from support.quick_pair import folder

__all__ = ["folder"]
