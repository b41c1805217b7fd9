"""Camera frames in a lab: their order and rate, which are of no use, what of them the guard has
accepted, and the buffer between its thread and readers. Times are ns on the run's clock.

A camera that does not number its frames may send the last one again and again, each time as if it
were new. Where poses of robots that stand have noise, each frame differs from the one before: one
that equals it to the last bit was not measured. Poses without noise, or on a grid, may repeat.
"""

import threading
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice

from tetractl.core.clock import SECOND
from tetractl.core.poses import CameraFrame, Pose
from tetractl.tools.worker import WAITING_MAX

SLOW_HZ = 20.0
"""Rate of frames below which one that is lost looks like a lost stream [Hz]."""
NOISE_FRAMES = 25
"""How many frames in a row have to differ in each body before the first run, so that poses count as
noisy: at 120 Hz 0.2 s, in which robots stand, or somebody carries one of them."""


@dataclass(slots=True)
class CameraStream:
    """The newest frame of a camera, and the frames that came too late."""

    newest: CameraFrame | None = None
    """The newest frame, None before the first."""
    repeats: bool = False
    """Whether it repeats the one before, though poses are noisy."""
    outdated: int = 0
    """How many frames came since the newest but were exposed before it, or together with it."""
    behind_ns: int = 0
    """By how much the last of these was behind."""
    dropped: int = 0
    """How many came too late since the last start of a run."""
    _noisy: bool = False
    """Whether poses of robots that stand differ in each frame."""
    _differ: int = 0
    """In how many of the newest frames, in a row, each body was elsewhere than in the one before,
    before robots were first driven."""
    _recent_ns: deque[int] = field(default_factory=deque)
    """When the frames of the last second were exposed, oldest first."""
    _damaged: deque[tuple[int, int]] = field(default_factory=deque)
    """The totals of damaged frames of the last second, each with its time, oldest first."""

    @property
    def newest_ns(self) -> int:
        """When the newest frame was exposed, 0 before the first."""
        return 0 if self.newest is None else self.newest.sampled_ns

    def advance(self, frame: CameraFrame, driven: bool) -> bool:
        """Take a frame; return whether it is newer than all before, and count it as dropped if it
        is not. `driven` says whether robots ever were.
        """
        exposed_ns = frame.sampled_ns
        before = self.newest
        if before is not None:
            if exposed_ns <= before.sampled_ns:
                self.dropped += 1
                self.outdated += 1
                self.behind_ns = before.sampled_ns - exposed_ns
                return False
            self._compare(frame, before, driven)
        self.newest = frame
        self.outdated = 0
        self._recent_ns.append(exposed_ns)
        while self._recent_ns[0] < exposed_ns - SECOND:
            self._recent_ns.popleft()
        return True

    def _compare(self, frame: CameraFrame, before: CameraFrame, driven: bool) -> None:
        """Look whether each body is where it was in the frame before, to the bit."""
        if not driven:
            bodies = [pair for pair in zip(frame.poses, before.poses, strict=True) if any(pair)]
            each_differs = bool(bodies) and all(now != then for now, then in bodies)
            self._differ = self._differ + 1 if each_differs else 0
            self._noisy |= self._differ >= NOISE_FRAMES
        is_equal = (frame.poses, frame.strangers) == (before.poses, before.strangers)
        self.repeats = is_equal and self._noisy

    @property
    def slow_text(self) -> str:
        """What is added to a reason that blames a robot if frames come slowly, "" if not."""
        recent_ns = self._recent_ns
        if not recent_ns or recent_ns[-1] - recent_ns[0] < SECOND // 2:
            return ""
        rate = rate_hz(range(len(recent_ns)), recent_ns)
        if rate is None or rate >= SLOW_HZ:
            return ""
        few = f"only {rate:.0f} pictures per second came, {SLOW_HZ:.0f} or more are needed"
        return f"; {few}: is this computer busy?"

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


@dataclass(frozen=True, slots=True)
class TimedPose:
    """A pose and the time of its exposure."""

    exposed_ns: int
    pose: Pose


def timed_poses(frames: Iterable[AcceptedFrame], i: int) -> list[TimedPose]:
    """Return the poses of robot i accepted from some frames."""
    timed: list[TimedPose] = []
    for frame in frames:
        pose = frame.pose(i)
        if pose is not None:
            timed.append(TimedPose(frame.exposed(i), pose))
    return timed


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
