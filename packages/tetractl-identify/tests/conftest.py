"""Pytest fixture for all tests of this package: a folder with the logs of two short trials."""

from testkit.quick_pair import folder

__all__ = ["folder"]
