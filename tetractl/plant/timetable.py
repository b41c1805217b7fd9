"""The times at which a simulation exposes camera frames and samples the true path."""

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.poses import Bools, Times

BLOCK_NS = 4 * SECOND
"""Duration of the block of times that is computed in advance [ns]."""
BLOCK_SPARE_NS = SECOND
"""Duration for which a block continues after its end [ns].

The block therefore always contains a next time, because rates are at least 1 Hz.
"""


@dataclass(frozen=True, slots=True)
class DueTimes:
    """The M times, in ascending order, at which a camera frame or a sample of the path is due."""

    times_ns: Times
    has_frame: Bools
    """Whether a camera frame is exposed at each time, shape (M,)."""
    has_sample: Bools
    """Whether the true path is sampled at each time, shape (M,)."""

    def select_rows(self, first_row: int, end_row: int) -> "DueTimes":
        """Return a copy of the rows from `first_row` up to, but not including, `end_row`."""
        rows = slice(first_row, end_row)
        return DueTimes(
            self.times_ns[rows].copy(), self.has_frame[rows].copy(), self.has_sample[rows].copy()
        )


class Timetable:
    """The times at which a simulation exposes frames and samples the path: k / rate, k = 0, 1, ...

    `take_until` returns the times in order, and each only once.

    Args:
        camera_hz: Number of frames per second [Hz].
        truth_hz: Number of samples of the true path per second [Hz].
    """

    def __init__(self, camera_hz: float, truth_hz: float) -> None:
        self._camera_hz = camera_hz
        self._truth_hz = truth_hz
        self.next_ns = 0
        """The first time that `take_until` has not returned yet [ns]."""
        self.next_frame_ns = 0
        """The first time of a frame that `take_until` has not returned yet [ns]."""
        self._compute_block(BLOCK_NS)

    def take_until(self, until_ns: int, with_end: bool) -> DueTimes:
        """Return the times up to and including `until_ns` that were not returned before.

        Args:
            until_ns: End of the times [ns].
            with_end: Whether the last time is always `until_ns`, even if neither a frame nor a
                sample is due then.
        """
        if until_ns + BLOCK_SPARE_NS >= self._block_end_ns:
            self._compute_block(until_ns + BLOCK_NS)
        first_row = self._taken_count
        end_row = bisect_right(self._block_times_ns, until_ns, first_row)
        self._taken_count = end_row
        self.next_ns = self._block_times_ns[end_row]
        self.next_frame_ns = self._next_frames_ns[end_row]
        is_end_due = end_row > first_row and self._block_times_ns[end_row - 1] == until_ns
        if is_end_due or not with_end:
            return self._block.select_rows(first_row, end_row)
        # the block has spare rows: copying one more is faster than appending one
        due_times = self._block.select_rows(first_row, end_row + 1)
        due_times.times_ns[-1] = until_ns
        due_times.has_frame[-1] = False
        due_times.has_sample[-1] = False
        return due_times

    def _compute_block(self, end_ns: int) -> None:
        """Compute the times from `next_ns` to `end_ns`, and for some spare time after it."""
        frames_ns = _compute_multiples(self._camera_hz, self.next_ns, end_ns + BLOCK_SPARE_NS)
        samples_ns = _compute_multiples(self._truth_hz, self.next_ns, end_ns + BLOCK_SPARE_NS)
        # np.unique does the same 70 times slower: it hashes what is nearly sorted
        merged_ns = np.sort(np.concatenate([frames_ns, samples_ns]), kind="stable")
        times_ns = merged_ns[np.append(True, merged_ns[1:] > merged_ns[:-1])]
        next_rows = np.searchsorted(frames_ns, times_ns)
        next_frames_ns = np.append(frames_ns, NEVER_NS)[next_rows]
        next_rows = np.searchsorted(samples_ns, times_ns)
        next_samples_ns = np.append(samples_ns, NEVER_NS)[next_rows]
        self._block_end_ns = end_ns
        self._taken_count = 0  # rows of the block that were returned
        self._block = DueTimes(
            times_ns, has_frame=next_frames_ns == times_ns, has_sample=next_samples_ns == times_ns
        )
        # the same times as a list, which is searched faster
        self._block_times_ns: list[int] = times_ns.tolist()
        # for each time the first time of a frame that is not before it [ns]
        self._next_frames_ns: list[int] = next_frames_ns.tolist()


def _compute_multiples(rate_hz: float, since_ns: int, until_ns: int) -> Times:
    """Compute the times k / rate in [since_ns, until_ns] for integer k, rounded to ns."""
    first_multiple = int(since_ns * rate_hz / SECOND) - 1
    last_multiple = int(until_ns * rate_hz / SECOND) + 2
    multiples = np.arange(first_multiple, last_multiple + 1)
    times_ns = np.rint(multiples * SECOND / rate_hz).astype(np.int64)
    return times_ns[(times_ns >= since_ns) & (times_ns <= until_ns)]
