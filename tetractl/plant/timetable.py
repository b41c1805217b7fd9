"""The times at which a simulation exposes camera frames and samples the true path."""

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.poses import Bools, Times

TIMES_BLOCK_NS = 4 * SECOND
"""Duration for which the timetable is computed in advance [ns]."""
SPARE_NS = SECOND
"""A block continues for this long after its end [ns], so that it always has a next time.

Rates are at least 1 Hz.
"""


@dataclass(frozen=True, slots=True)
class DueTimes:
    """The M times in one part of a simulation at which a frame or a sample is due, ascending."""

    times_ns: Times
    frames: Bools
    """Whether a camera frame is exposed at each time, shape (M,)."""
    samples: Bools
    """Whether the true path is sampled at each time, shape (M,)."""

    def select_rows(self, first_row: int, end_row: int) -> "DueTimes":
        """Return a copy of the times from row `first_row` up to, but not including, `end_row`."""
        rows = slice(first_row, end_row)
        return DueTimes(
            self.times_ns[rows].copy(), self.frames[rows].copy(), self.samples[rows].copy()
        )


class Timetable:
    """The times of frames and samples of a simulation: k / rate [ns] with k = 0, 1, 2, ...

    `take` returns the times in order, and each only once.

    Args:
        camera_hz: Number of frames per second [Hz].
        truth_hz: Number of samples of the true path per second [Hz].
    """

    def __init__(self, camera_hz: float, truth_hz: float) -> None:
        self._camera_hz = camera_hz
        self._truth_hz = truth_hz
        self.next_ns = 0
        """The first time that `take` has not returned yet [ns]."""
        self.next_frame_ns = 0
        """The first time of a frame that `take` has not returned yet [ns]."""
        self._compute_block(TIMES_BLOCK_NS)

    def take(self, until_ns: int, with_end: bool) -> DueTimes:
        """Take the times up to and including `until_ns`.

        If `with_end` is True, the last time is always `until_ns`, even if neither a frame nor a
        sample is due then.
        """
        if until_ns + SPARE_NS >= self._end_ns:
            self._compute_block(until_ns + TIMES_BLOCK_NS)
        first_row = self._taken
        end_row = bisect_right(self._times, until_ns, first_row)
        self._taken = end_row
        self.next_ns = self._times[end_row]
        self.next_frame_ns = self._next_frames_ns[end_row]
        is_end_due = end_row > first_row and self._times[end_row - 1] == until_ns
        if is_end_due or not with_end:
            return self._block.select_rows(first_row, end_row)
        # the block has spare rows: copying one more is faster than appending one
        due = self._block.select_rows(first_row, end_row + 1)
        due.times_ns[-1] = until_ns
        due.frames[-1] = False
        due.samples[-1] = False
        return due

    def _compute_block(self, end_ns: int) -> None:
        """Compute the times from the next one to `end_ns`, and some spare time after it."""
        frames_ns = _multiples(self._camera_hz, self.next_ns, end_ns + SPARE_NS)
        samples_ns = _multiples(self._truth_hz, self.next_ns, end_ns + SPARE_NS)
        # np.unique does the same 70 times slower: it hashes what is nearly sorted
        merged_ns = np.sort(np.concatenate([frames_ns, samples_ns]), kind="stable")
        times_ns = merged_ns[np.append(True, merged_ns[1:] > merged_ns[:-1])]
        next_rows = np.searchsorted(frames_ns, times_ns)
        next_frames_ns = np.append(frames_ns, NEVER_NS)[next_rows]
        next_rows = np.searchsorted(samples_ns, times_ns)
        next_samples_ns = np.append(samples_ns, NEVER_NS)[next_rows]
        self._end_ns = end_ns
        self._taken = 0  # number of times of the block that were taken
        self._block = DueTimes(
            times_ns, frames=next_frames_ns == times_ns, samples=next_samples_ns == times_ns
        )
        self._times: list[int] = times_ns.tolist()  # the same times; a list is searched faster
        # for each time the first time of a frame that is not before it [ns]
        self._next_frames_ns: list[int] = next_frames_ns.tolist()


def _multiples(rate_hz: float, since_ns: int, until_ns: int) -> Times:
    """Return the times k / rate with integer k, rounded to ns, in [since_ns, until_ns]."""
    first_multiple = int(since_ns * rate_hz / SECOND) - 1
    last_multiple = int(until_ns * rate_hz / SECOND) + 2
    multiples = np.arange(first_multiple, last_multiple + 1)
    times_ns = np.rint(multiples * SECOND / rate_hz).astype(np.int64)
    return times_ns[(times_ns >= since_ns) & (times_ns <= until_ns)]
