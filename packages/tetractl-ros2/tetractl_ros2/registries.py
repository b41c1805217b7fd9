"""The parts that this package adds to `tetractl init --lab`."""

from pathlib import Path

TEMPLATES = Path(__file__).parent / "templates"
"""The folder of the parts of `tetractl init --lab --camera ros2 --robots ros2`."""
