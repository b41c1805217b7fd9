"""The order and the rate of a camera's frames, and how many are of no use. Times are ns on the
run's clock.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from tetractl.core.clock import SECOND


@dataclass(slots=True)
class CameraStream:
    """The newest frame of a camera, and the frames that came too late."""

    exposed_ns: int | None = None
    """When the newest frame was exposed, None before the first."""
    own_times: bool = False
    """Whether its poses have times of their own."""
    outdated: int = 0
    """How many frames came since the newest but were exposed before it, or together with it."""
    behind_ns: int = 0
    """By how much the last of these was behind."""
    dropped: int = 0
    """How many came too late since the last start of a run."""
    refused: int = 0
    """How many poses the guard has refused."""
    _damaged: deque[tuple[int, int]] = field(default_factory=deque)
    """The totals of damaged frames of the last second, each with its time, oldest first."""

    @property
    def newest_ns(self) -> int:
        """When the newest frame was exposed, 0 before the first."""
        return self.exposed_ns or 0

    def advance(self, exposed_ns: int, own_times: bool) -> bool:
        """Take a frame; return whether it is newer than all before, and count it as dropped if it
        is not.
        """
        if self.exposed_ns is not None and exposed_ns <= self.exposed_ns:
            self.dropped += 1
            self.outdated += 1
            self.behind_ns = self.exposed_ns - exposed_ns
            return False
        self.exposed_ns = exposed_ns
        self.own_times = own_times
        self.outdated = 0
        return True

    @property
    def outdated_text(self) -> str:
        """A text on how old the last outdated frame was."""
        return f"exposed {self.behind_ns / SECOND:.2f} s before the newest frame"

    def frameless_text(self, silent_ns: int) -> str:
        """Return a text that no new frame has come for so long, with those that came too late."""
        text = f"no new camera frame for {silent_ns / SECOND:.2f} s"
        if not self.outdated:
            return text
        return f"{text}: {self.outdated} outdated frames came, the last {self.outdated_text}"

    def damaged_recently(self, now_ns: int, total: int) -> int:
        """Take the total of pictures or datagrams that could not be read; return by how much it
        rose within the second before."""
        totals = self._damaged
        totals.append((now_ns, total))
        while totals[0][0] < now_ns - SECOND:
            totals.popleft()
        return total - totals[0][1]


def rate_hz(numbers: Sequence[int], received_ns: Sequence[int]) -> float | None:
    """Return the rate [Hz] of frames or pictures with these numbers, received at these times, those
    between them included; None for fewer than two.
    """
    if len(numbers) < 2 or received_ns[-1] <= received_ns[0]:
        return None
    return (numbers[-1] - numbers[0]) * SECOND / (received_ns[-1] - received_ns[0])
