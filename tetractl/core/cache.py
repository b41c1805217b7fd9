"""The folder for compiled code, and a name for the sources it was compiled from."""

import hashlib
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path


def cache_folder() -> Path:
    """Return the user's cache folder for tetractl, or a temporary one where it cannot be made."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(base) / "tetractl"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"tetractl-{os.getuid()}"
    return folder


def digest(sources: Iterable[Path], options: str = "") -> str:
    """Return 12 hex digits that name the contents of files and the options to compile them with."""
    found = hashlib.sha256()
    for source in sorted(sources):
        found.update(source.read_bytes())
    found.update(options.encode())
    return found.hexdigest()[:12]
