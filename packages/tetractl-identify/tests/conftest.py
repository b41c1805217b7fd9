"""The folder of two short trials, for all tests here."""

from testkit.quick_pair import folder

__all__ = ["folder"]
