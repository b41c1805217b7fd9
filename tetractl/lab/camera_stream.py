"""Check the stream of camera frames before anybody looks at their poses: order, rate, repeats.

    CameraStream        the newest frame, and how many frames came too late
      RepeatDetector    whether a frame repeats the previous one
      RateWindow        how many frames arrive per second
      DamagedCount      how many frames could not be read within the last second

Times are on the run's clock [ns].
"""

from collections import deque
from collections.abc import Sequence

from tetractl.core.clock import SECOND
from tetractl.core.poses import CameraFrame

RATE_MIN_HZ = 20.0
"""Rate of frames below which one lost frame looks like a lost stream [Hz]."""
NOISE_FRAMES = 25
"""Number of frames in a row in which each body's pose must change for poses to count as noisy.

They come before the first run. At 120 Hz they take 0.2 s, in which robots stand still, or somebody
carries one of them.
"""


def compute_rate_hz(numbers: Sequence[int], received_ns: Sequence[int]) -> float | None:
    """Compute the rate of frames or images [Hz]. Lost frames in between count too.

    Args:
        numbers: The numbers that the camera gave to the frames.
        received_ns: When each frame was received [ns].

    Returns:
        The rate. None if there are fewer than two frames, or if no time has passed.
    """
    if len(numbers) < 2 or received_ns[-1] <= received_ns[0]:
        return None
    return (numbers[-1] - numbers[0]) * SECOND / (received_ns[-1] - received_ns[0])


class RepeatDetector:
    """Detects a camera that sends its last frame again and again, each time as if it were new.

    If measurements are noisy, even the poses of stationary robots differ from frame to frame. Then
    a frame that equals the previous one to the last bit is not a new measurement. If poses have no
    noise, or are rounded to a grid, they may repeat.
    """

    def __init__(self) -> None:
        self.repeats = False
        """Whether the last frame equals the one before, although measurements are noisy."""
        self._is_noisy = False
        self._differing_in_a_row = 0  # frames before robots were first driven

    def add(self, frame: CameraFrame, previous: CameraFrame, was_driven: bool) -> None:
        """Compare a camera frame with the previous one, and note which poses repeat.

        Args:
            frame: The frame.
            previous: The previous frame.
            was_driven: Whether robots have ever been driven.
        """
        if not was_driven and not self._is_noisy:
            if _do_all_bodies_differ(frame, previous):
                self._differing_in_a_row += 1
            else:
                self._differing_in_a_row = 0
            self._is_noisy = self._differing_in_a_row >= NOISE_FRAMES
        is_equal = (frame.poses, frame.unknown_objects) == (
            previous.poses,
            previous.unknown_objects,
        )
        self.repeats = is_equal and self._is_noisy


def _do_all_bodies_differ(frame: CameraFrame, previous: CameraFrame) -> bool:
    """Check whether every body in one of two frames has a different pose in the other one."""
    poses = zip(frame.poses, previous.poses, strict=True)
    tracked = [(new, old) for new, old in poses if new is not None or old is not None]
    return bool(tracked) and all(new != old for new, old in tracked)


class RateWindow:
    """The times of the frames of the last second, from which their rate is computed."""

    def __init__(self) -> None:
        self._exposed_ns: deque[int] = deque()

    def add(self, exposed_ns: int) -> None:
        """Add the exposure time of a frame that is newer than all previous ones [ns]."""
        self._exposed_ns.append(exposed_ns)
        while self._exposed_ns[0] < exposed_ns - SECOND:
            self._exposed_ns.popleft()

    @property
    def rate_hz(self) -> float | None:
        """The rate of the frames [Hz]. None if they span less than half a second."""
        times_ns = self._exposed_ns
        if not times_ns or times_ns[-1] - times_ns[0] < SECOND // 2:
            return None
        return compute_rate_hz(range(len(times_ns)), times_ns)


class DamagedCount:
    """The number of camera images or datagrams that could not be read within the last second."""

    def __init__(self) -> None:
        self._totals: deque[tuple[int, int]] = deque()  # each with its time, oldest first

    def add(self, now_ns: int, total: int) -> None:
        """Record the total number of unreadable images or datagrams so far, at a time [ns]."""
        self._totals.append((now_ns, total))
        while self._totals[0][0] < now_ns - SECOND:
            self._totals.popleft()

    @property
    def recent(self) -> int:
        """The number of images or datagrams that became unreadable within the last second."""
        return self._totals[-1][1] - self._totals[0][1] if self._totals else 0


class CameraStream:
    """The newest frame of a camera, and the frames that came too late.

    Attributes:
        newest: The newest frame. None before the first one.
        outdated_count: Number of frames that arrived after the newest frame, but were not exposed
            after it.
        outdated_by_ns: How much older than the newest frame the last of these frames was [ns].
        dropped_count: Number of frames that came too late since the last start of a run.
        damaged: Counts images or datagrams that could not be read.
    """

    def __init__(self) -> None:
        self.newest: CameraFrame | None = None
        self.outdated_count = 0
        self.outdated_by_ns = 0
        self.dropped_count = 0
        self.damaged = DamagedCount()
        self._repeated = RepeatDetector()
        self._rate = RateWindow()

    @property
    def newest_ns(self) -> int:
        """The exposure time of the newest frame [ns]. 0 before the first frame."""
        return 0 if self.newest is None else self.newest.sampled_ns

    @property
    def repeats(self) -> bool:
        """Whether the newest frame repeats the previous one, although measurements are noisy."""
        return self._repeated.repeats

    def add_frame(self, frame: CameraFrame, was_driven: bool) -> bool:
        """Add a camera frame. A frame that is not newer than all others counts as dropped.

        Args:
            frame: The frame.
            was_driven: Whether robots were ever driven.

        Returns:
            Whether the frame is newer than all previous ones.
        """
        exposed_ns = frame.sampled_ns
        previous = self.newest
        if previous is not None:
            if exposed_ns <= previous.sampled_ns:
                self.dropped_count += 1
                self.outdated_count += 1
                self.outdated_by_ns = previous.sampled_ns - exposed_ns
                return False
            self._repeated.add(frame, previous, was_driven)
        self.newest = frame
        self.outdated_count = 0
        self._rate.add(exposed_ns)
        return True

    @property
    def slow_hint(self) -> str:
        """A hint that frames come too slowly, to append to errors that blame a robot.

        The hint is empty if frames come fast enough, or if their rate is not known yet.
        """
        rate = self._rate.rate_hz
        if rate is None or rate >= RATE_MIN_HZ:
            return ""
        rate_text = (
            f"only {rate:.0f} images per second came, but at least {RATE_MIN_HZ:.0f} are needed"
        )
        return f"; {rate_text}: is this computer busy?"

    @property
    def outdated_text(self) -> str:
        """The end of a message: how much older the last outdated frame was than the newest."""
        return f"exposed {self.outdated_by_ns / SECOND:.2f} s before the newest frame"

    def describe_silence(self, silent_ns: int) -> str:
        """Create a message that no new frame has arrived for a time, and how many came too late."""
        message = f"no new camera frame for {silent_ns / SECOND:.2f} s"
        if not self.outdated_count:
            return message
        return (
            f"{message}: {self.outdated_count} outdated frames came, and the last of them was "
            f"{self.outdated_text}"
        )
