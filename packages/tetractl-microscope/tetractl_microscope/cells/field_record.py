"""The directions of the field that were sent, as pieces of constant field for the filter."""

import math
import threading
from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.tools.worker import WAITING_MAX
from tetractl_microscope.cells.helix import Piece


class FieldSignal(NamedTuple):
    """The direction [rad] of the field from a time [ns] on; None if it is off."""

    sent_ns: int
    direction: float | None


class FieldSignals:
    """The newest directions, in order of time. One thread may note them, another one ask."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sent: deque[FieldSignal] = deque(maxlen=WAITING_MAX)

    def note(self, direction: float | None, sent_ns: int) -> None:
        """Note a direction sent at a time [ns], None if the field was switched off."""
        with self._lock:
            if not self._sent or self._sent[-1].direction != direction:
                self._sent.append(FieldSignal(sent_ns, direction))

    def pieces(self, start: float, end: float, rotation: float) -> Sequence[Piece]:
        """Return the pieces of constant field between two times [s], in axes that are turned by
        `rotation` [rad]. Before the first direction there is no field.
        """
        with self._lock:
            sent = list(self._sent)
        times = [entry.sent_ns / SECOND for entry in sent]
        first = bisect_right(times, start)
        last = bisect_right(times, end)
        before = sent[first - 1].direction if first else None
        directions = [before, *(entry.direction for entry in sent[first:last])]
        durations = np.diff([start, *times[first:last], end]).tolist()
        return [
            _piece(duration, direction, rotation)
            for duration, direction in zip(durations, directions, strict=True)
        ]


def _piece(duration: float, direction: float | None, rotation: float) -> Piece:
    """Return a time [s] with the field in one direction."""
    if direction is None:
        return (duration, 0.0, 0.0)
    turned = direction - rotation
    return (duration, math.cos(turned), math.sin(turned))
