"""The camera frames that the guard accepted, and the buffer that holds them."""

import threading
from collections import deque
from dataclasses import dataclass
from itertools import islice

from tetractl.core.poses import CameraFrame, Pose

KEPT = 20_000  # frames: nearly 3 minutes at 120 Hz between two reads of one reader


@dataclass(frozen=True, slots=True)
class AcceptedFrame:
    """A frame exposed after those before it, and what the guard accepted of it, of N robots.

    `poses` (N,) are the last accepted poses, None before a robot's first; `fresh` (N,) is whether
    they are of this frame; if not, the robot was not tracked in it, or its pose was refused.
    """

    frame: CameraFrame
    poses: tuple[Pose | None, ...]
    fresh: tuple[bool, ...]

    def pose(self, i: int) -> Pose | None:
        """Return robot i's accepted pose in this frame, None without one."""
        return self.poses[i] if self.fresh[i] else None


class FrameBuffer:
    """The last `KEPT` accepted frames, oldest first; the inner loop appends, any thread reads."""

    def __init__(self) -> None:
        self.newest: AcceptedFrame | None = None
        self.count = 0  # of all frames ever appended
        self._frames: deque[AcceptedFrame] = deque(maxlen=KEPT)
        self._lock = threading.Lock()

    def append(self, frame: AcceptedFrame) -> None:
        """Add the next frame."""
        with self._lock:
            self._frames.append(frame)
            self.newest = frame
            self.count += 1

    def since(self, count: int) -> tuple[list[AcceptedFrame], int]:
        """Return the frames after the first `count` ever appended, oldest first, and the number of
        all, for the next call. Frames no longer kept are left out.
        """
        with self._lock:
            return list(islice(reversed(self._frames), self.count - count))[::-1], self.count

    def last(self, span_ns: int) -> list[AcceptedFrame]:
        """Return the frames exposed at most `span_ns` before the newest, oldest first."""
        with self._lock:
            found: list[AcceptedFrame] = []
            for frame in reversed(self._frames):
                if self._frames[-1].frame.sampled_ns - frame.frame.sampled_ns > span_ns:
                    break
                found.append(frame)
        return found[::-1]
