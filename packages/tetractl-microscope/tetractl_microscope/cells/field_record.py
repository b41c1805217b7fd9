"""The field over time, in a table or in the lab, as intervals of constant field for the filter."""

import math
import threading
from collections import deque
from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats
from tetractl.tools.worker import QUEUE_MAX
from tetractl_microscope.cells.helix import Piece
from tetractl_microscope.sent_directions import SentDirections

NO_FIELD_YET = (-math.inf, 0.0, 0.0)
"""Time [s], direction and strength of the field before the first direction."""


class FieldRecord(SentDirections):
    """The direction and strength of the magnetic field over time, which change in steps.

    There is no field before the first time, and the last value lasts for ever.
    """

    def items(self) -> dict[str, Floats]:
        """Convert the field to a mapping for records.

        Returns:
            "time_s" maps to the times [s], and "x" and "y" to the components of the field from that
            time until the next.
        """
        return {"time_s": self.times, "x": self.fields.real, "y": self.fields.imag}

    def pieces(self, start_s: float, end_s: float) -> Sequence[Piece]:
        """Return the field between two times [s] as constant pieces, oldest first.

        Each piece has its duration [s], x and y. Before the first recorded time, x and y
        are 0.
        """
        first_index, stop_index = np.searchsorted(self.times, (start_s, end_s), side="right")
        cuts_s = np.array([start_s, *self.times[first_index:stop_index], end_s])
        fields = self.field_at(cuts_s[:-1])
        pieces = np.column_stack([np.diff(cuts_s), fields.real, fields.imag])
        return [(duration_s, x, y) for duration_s, x, y in pieces.tolist()]


class FieldSignals:
    """A record of the newest field directions that were sent, in the order of time.

    One thread may record them while another reads them.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest_direction: float | None = None
        self._sent = deque[tuple[float, float, float]](maxlen=QUEUE_MAX)

    def note(self, direction: float | None, sent_ns: int) -> None:
        """Record a direction that was sent, unless it equals the previous one.

        Args:
            direction: The direction [rad]. None if the field was switched off.
            sent_ns: When it was sent [ns].
        """
        with self._lock:
            if not self._sent or self._newest_direction != direction:
                strength = 0.0 if direction is None else 1.0
                self._sent.append((sent_ns / SECOND, direction or 0.0, strength))
                self._newest_direction = direction

    def record(self, rotation: float) -> FieldRecord:
        """Return the recorded field in axes that are rotated by `rotation` [rad], anticlockwise.

        There is no field before the first direction, and only the newest QUEUE_MAX directions
        are kept.
        """
        with self._lock:
            signals = [NO_FIELD_YET, *self._sent]
        times, directions, strengths = np.array(signals).T
        return FieldRecord(times, directions - rotation, strengths)
