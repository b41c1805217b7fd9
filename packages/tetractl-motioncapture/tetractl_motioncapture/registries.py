"""What this package brings in addition to its camera: a part of `tetractl init --lab`."""

from pathlib import Path

TEMPLATES = Path(__file__).parent / "templates"
"""The folder of the parts of `tetractl init --lab --camera motioncapture`."""
