"""Loads a spec for a command, and tells what it calls by an earlier name."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec


def load(path: Path, sets: Sequence[str]) -> "LoadedSpec":
    """Return a spec, with one line on stderr for each name in it that has changed."""
    from tetractl.experiment.load import load_spec

    loaded = load_spec(path, sets)
    for notice in loaded.notices:
        print(f"notice: {notice}", file=sys.stderr)
    return loaded
