"""Pytest fixture for all tests here: a folder with the logs of two short trials."""

from testkit.quick_pair import folder

__all__ = ["folder"]
