"""The camera of a simulation: exposure times, measurements and arrival times."""

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import NEVER, SECOND
from tetractl.core.commands import Sample
from tetractl.core.errors import WrongValueError
from tetractl.core.poses import POSE_MAX, Bools, Floats, Observation, Poses, Times
from tetractl.experiment.base import Model, NonNegative
from tetractl.experiment.disturbance import Disturbance, overriding

BLOCK_NS = 4 * SECOND  # times are laid out for so long in advance


class Beats:
    """The times of the camera's frames and of the samples of the true path: k / rate [ns] for
    k = 0, 1, 2, ..., in order. `next_ns` is the next time, `next_frame_ns` the next of a frame."""

    def __init__(self, camera_hz: float, truth_hz: float) -> None:
        self._rates_hz, self._laid_ns = (camera_hz, truth_hz), -1
        self.next_ns = self.next_frame_ns = 0

    def due(self, until: int, ends: bool = False) -> tuple[Times, Bools]:
        """Pass the times (M,) up to `until`; return them, and which are a frame's and which a
        sample's (2, M). If it `ends` a part of the path, `until` is always the last of them."""
        if until + SECOND >= self._laid_ns:
            self._lay_out(until + BLOCK_NS)
        begin, end = self._passed, bisect_right(self._each, until, self._passed)
        self._passed, self.next_ns, self.next_frame_ns = end, self._each[end], self._frame[end]
        if not ends or (end > begin and self._each[end - 1] == until):
            return self._times[begin:end], self._kinds[:, begin:end]
        times, kinds = self._times[begin : end + 1].copy(), self._kinds[:, begin : end + 1].copy()
        times[-1], kinds[:, -1] = until, False
        return times, kinds

    def _lay_out(self, until: int) -> None:
        """Lay out the times from the next one to `until` [ns] and at least a second more."""
        since, self._laid_ns, self._passed = self.next_ns, until, 0
        both = list[Times]()
        for rate in self._rates_hz:
            first, last = (int(when * rate / SECOND) for when in (since, until + SECOND))
            times = np.rint(np.arange(first - 1, last + 3) * SECOND / rate).astype(np.int64)
            both.append(times[(times >= since) & (times <= until + SECOND)])
        times = np.sort(np.concatenate(both))
        self._times = times = times[np.diff(times, prepend=-1) > 0]
        later = [np.append(each, NEVER)[np.searchsorted(each, times)] for each in both]
        self._kinds = np.array([each == times for each in later])
        self._each, self._frame = times.tolist(), later[0].tolist()


class MeasurementNoise(Model):
    """Standard deviations of the normally distributed errors of each camera frame."""

    position: NonNegative = 0.0
    """Standard deviation of x and of y [length unit]."""
    heading: NonNegative = 0.0
    """Standard deviation of the heading [rad]."""


class SimCamera:
    """Makes frames of the true poses; `disturbances` change, delay and lose them."""

    def __init__(
        self,
        robots: int,
        noise: MeasurementNoise,
        rng: np.random.Generator,
        disturbances: Sequence[Disturbance],
    ) -> None:
        self.noise = np.array([[noise.position], [noise.position], [noise.heading]])
        self._noisy, self.rng = bool(self.noise.any()), rng
        self._measured = overriding(disturbances, "measured")
        self._received = [one.received for one in overriding(disturbances, "received")]
        self._tracked = np.ones(robots, dtype=np.bool_)
        self._tracked.setflags(write=False)  # shared by all frames
        self._exposed = 0  # number of frames so far
        self._arrived_ns = 0  # when the last of them arrives that is not lost [ns]
        self._shown: Poses | None = None  # poses in the last frame
        self._under_way: deque[Sample] = deque()
        self._fresh: list[Sample] = []
        self.newest: Observation | None = None
        """The newest frame that the host has received."""

    @property
    def arriving_ns(self) -> int | None:
        """The time when the next frame reaches the host [ns], None if no frame is in transit."""
        return self._under_way[0].observation.received_ns if self._under_way else None

    def expose(self, times: Times, truth: Floats) -> None:
        """Expose the next frames at `times` (F,) [ns] with the robots at x, y, heading `truth`
        (F, 3, N)."""
        seen = truth
        if self._noisy:
            seen = truth + self.noise * self.rng.standard_normal(truth.shape)
        at, valid = times.tolist(), self._tracked
        for when, arrives, true, measured in zip(at, self.arrivals(at), truth, seen, strict=True):
            number, poses = self._exposed, Poses(*true)
            shown = Poses(*measured) if self._noisy else poses
            self._exposed += 1
            if self._measured:
                shown, valid = self._disturb(shown, when)
            if arrives < NEVER:
                self._shown = shown
                frame = Observation(number, when, arrives, shown, valid)
                self._under_way.append(Sample(frame, poses))

    def arrivals(self, times: Sequence[int]) -> list[int]:
        """Return when the next frames, exposed at `times`, reach the host [ns]; NEVER if lost.

        Frame 0 has no latency, because the camera sees the standing robots before the trial.
        """
        found = list[int]()
        for when in times:
            at: int | None = when
            for receive in self._received if when else ():
                at = receive(when, at)
                if at is None:
                    break
                if not at >= when:  # NaN, too
                    text = f"the arrival of a frame before its exposure: {at} ns"
                    raise WrongValueError(self, "a disturbance", text)
            if at is not None and at > self._arrived_ns:
                self._arrived_ns = at
            found.append(NEVER if at is None else self._arrived_ns)
        return found

    def _disturb(self, measured: Poses, when: int) -> tuple[Poses, Bools]:
        """Return the poses as disturbed at a time [ns], and which robots are tracked."""
        valid = self._tracked.copy()
        for disturbance in self._measured:
            measured, valid = disturbance.measured(measured, valid, when / SECOND)
        if not (np.abs(measured.array()[valid]) <= POSE_MAX).all():
            raise WrongValueError(self, "a disturbance", "a measured pose that no log can hold")
        # a robot that is not tracked keeps its last pose
        if self._shown is not None and not valid.all():
            last, now = self._shown.array(), measured.array()
            measured = Poses.of(np.where(valid[:, None], now, last))
        return measured, valid

    def receive(self, until: int) -> None:
        """Pass to the host every frame that arrives up to `until` [ns]."""
        while self._under_way and self._under_way[0].observation.received_ns <= until:
            sample = self._under_way.popleft()
            self.newest = sample.observation
            self._fresh.append(sample)

    def samples(self) -> list[Sample]:
        """Return every frame received since the last call, oldest first."""
        fresh, self._fresh = self._fresh, []
        return fresh
