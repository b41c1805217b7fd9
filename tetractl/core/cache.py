"""Where compiled code is kept between runs, by what it was compiled from."""

import hashlib
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path


def cache_folder() -> Path:
    """Return the user's cache folder for tetractl, or a temporary one where that cannot be."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(base) / "tetractl"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"tetractl-{os.getuid()}"
    return folder


def digest(sources: Iterable[Path]) -> str:
    """Return a name for the contents of some files: 12 hex digits."""
    found = hashlib.sha256()
    for source in sorted(sources):
        found.update(source.read_bytes())
    return found.hexdigest()[:12]
