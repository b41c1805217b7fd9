"""The files that a spec draws on: their texts go into the log with it, by their names."""

from pathlib import Path

from tetractl.core.errors import SpecError
from tetractl.core.text import printable
from tetractl.core.trial import OWN_FILES

Attached = tuple[tuple[str, str], ...]


def attach(attached: Attached, path: Path, text: str) -> Attached:
    """Return the files attached with one more; SpecError where a log has another of that name."""
    name = printable(path.name)
    if name in OWN_FILES or name in dict(attached):
        raise SpecError(
            f"{printable(str(path))}: the log of a trial holds another {name}",
            "give this file a name of its own",
        )
    return (*attached, (name, text))
