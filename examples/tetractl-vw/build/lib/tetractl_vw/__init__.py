"""Robots that take lines `v w` by UDP, and a camera that sends their poses as JSON."""

from pathlib import Path

TEMPLATES = Path(__file__).parent / "templates"
"""The folder of the parts of `tetractl init --lab --robots vw`."""
