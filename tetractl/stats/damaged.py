"""Logs and rows that trials could not be read from."""

from dataclasses import dataclass
from pathlib import Path

from tetractl.log.read.find import is_set_aside


@dataclass(frozen=True, slots=True)
class Damaged:
    """A log from which no trial could be read, or rows that lack some, and why."""

    path: str
    problem: str

    @property
    def set_aside(self) -> bool:
        """Whether it is an attempt that was set aside, so that the batch lacks nothing."""
        return is_set_aside(Path(self.path).name)
