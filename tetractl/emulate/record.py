"""The emulator's own record: JSON lines, one event each, with the host's monotonic time."""

import json
from pathlib import Path
from typing import Any, TextIO

from tetractl.core.errors import TetractlError


class Record:
    """Writes events to a file, or nowhere without a path. `t_ns` is `time.monotonic_ns`."""

    def __init__(self, path: Path | None) -> None:
        self._file: TextIO | None = None
        if path is not None:
            try:
                self._file = path.open("w", encoding="utf-8")
            except OSError as error:
                raise TetractlError(f"cannot write the record {path}: {error.strerror}") from None

    def add(self, t_ns: int, event: str, **facts: Any) -> None:
        """Append an event."""
        if self._file is not None:
            line = {"t_ns": t_ns, "event": event, **facts}
            self._file.write(json.dumps(line, separators=(",", ":")) + "\n")

    def flush(self) -> None:
        """Hand over to the system what was added."""
        if self._file is not None:
            self._file.flush()

    def close(self) -> None:
        """Close the file; idempotent."""
        if self._file is not None:
            self._file.close()
            self._file = None
