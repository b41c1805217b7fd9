"""Frames with the poses that the guard accepted, and the buffer between its thread and readers."""

import threading
from collections import deque
from dataclasses import dataclass
from itertools import islice

from tetractl.core.poses import CameraFrame, Pose
from tetractl.tools.worker import WAITING_MAX


@dataclass(frozen=True, slots=True)
class AcceptedFrame:
    """A camera frame, exposed after all earlier frames, and the N robots' poses that the guard has
    accepted.

    `poses` (N,) are the last accepted poses, None before a robot's first. `fresh` (N,) is whether a
    pose is from this frame; if not, the robot was not tracked or its pose was refused. `exposed_ns`
    (N,) are the times of the poses if they have their own, otherwise it is empty.
    """

    frame: CameraFrame
    poses: tuple[Pose | None, ...]
    fresh: tuple[bool, ...]
    exposed_ns: tuple[int, ...] = ()

    def exposed(self, i: int) -> int:
        """Return the time of the pose of robot i [ns]."""
        return self.exposed_ns[i] if self.exposed_ns else self.frame.sampled_ns

    def pose(self, i: int) -> Pose | None:
        """Return the pose of robot i accepted from this frame, None if there is none."""
        return self.poses[i] if self.fresh[i] else None


def as_shown(frame: CameraFrame) -> AcceptedFrame:
    """Return a frame as if the guard had accepted every pose in it."""
    fresh = tuple(pose is not None for pose in frame.poses)
    return AcceptedFrame(frame, frame.poses, fresh, frame.exposed_ns)


class FrameBuffer:
    """The last accepted frames, oldest first; the inner loop appends, any thread reads."""

    def __init__(self) -> None:
        self.newest: AcceptedFrame | None = None
        self.count = 0  # number of frames appended so far
        self._frames: deque[AcceptedFrame] = deque(maxlen=WAITING_MAX)
        self._lock = threading.Lock()

    def append(self, frame: AcceptedFrame) -> None:
        """Append the next frame, and drop the oldest one if the buffer is full."""
        with self._lock:
            self._frames.append(frame)
            self.newest = frame
            self.count += 1

    def since(self, count: int) -> tuple[list[AcceptedFrame], int]:
        """Return the frames after the first `count`, oldest first, and the number of all frames so
        far: the `count` for the next call. Frames dropped from the buffer are left out.
        """
        with self._lock:
            return list(islice(reversed(self._frames), self.count - count))[::-1], self.count

    def last(self, span_ns: int) -> list[AcceptedFrame]:
        """Return the frames exposed at most `span_ns` before the newest, oldest first."""
        with self._lock:
            frames: list[AcceptedFrame] = []
            for frame in reversed(self._frames):
                if self._frames[-1].frame.sampled_ns - frame.frame.sampled_ns > span_ns:
                    break
                frames.append(frame)
        return frames[::-1]
