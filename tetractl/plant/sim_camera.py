"""The camera of a simulation: exposure times, measurements and arrival times."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Sample
from tetractl.core.poses import Bools, Observation, Poses
from tetractl.experiment.base import Model, NonNegative
from tetractl.experiment.disturbance import Disturbance, overriding


class Beat:
    """The times k / `rate_hz` [ns] for k = 0, 1, 2, ...; `next_ns` is the next of them."""

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz, self._count, self.next_ns = rate_hz, 0, 0

    def due(self, until: int) -> list[int]:
        """Pass the times up to `until`, and return them."""
        times = list[int]()
        while self.next_ns <= until:
            times.append(self.next_ns)
            self._count += 1
            self.next_ns = round(self._count * SECOND / self.rate_hz)
        return times


class MeasurementNoise(Model):
    """Standard deviations of the normally distributed errors of each camera frame."""

    position: NonNegative = 0.0
    """Standard deviation of x and of y [length unit]."""
    heading: NonNegative = 0.0
    """Standard deviation of the heading [rad]."""


class SimCamera:
    """Exposes frames at a steady rate [Hz]; `disturbances` change, delay and lose them."""

    def __init__(
        self,
        robots: int,
        rate_hz: float,
        noise: MeasurementNoise,
        rng: np.random.Generator,
        disturbances: Sequence[Disturbance],
    ) -> None:
        self.beat, self._noise, self._rng = Beat(rate_hz), noise, rng
        self._measured = overriding(disturbances, "measured")
        self._received = overriding(disturbances, "received")
        self._tracked = np.ones(robots, dtype=np.bool_)
        self._tracked.setflags(write=False)  # shared by all frames
        self._exposed = 0  # number of frames so far
        self._shown: Poses | None = None  # poses in the last frame
        self._under_way: deque[Sample] = deque()
        self._fresh: list[Sample] = []
        self.newest: Observation | None = None
        """The newest frame that the host has received."""

    @property
    def arriving_ns(self) -> int | None:
        """The time when the next frame reaches the host [ns], None if no frame is in transit."""
        return self._under_way[0].observation.received_ns if self._under_way else None

    def expose(self, when: int, truth: Poses) -> None:
        """Expose the next frame at `when` [ns] with the robots at the poses `truth`."""
        number = self._exposed
        self._exposed += 1
        measured = truth
        if self._noise.position > 0 or self._noise.heading > 0:
            x, y, heading = self._rng.standard_normal((3, truth.x.size))
            measured = Poses(
                truth.x + self._noise.position * x,
                truth.y + self._noise.position * y,
                truth.heading + self._noise.heading * heading,
            )
        valid = self._tracked
        if self._measured:
            measured, valid = self._disturb(measured, when)
        received: int | None = when
        # frame 0 has no latency, because the camera sees the standing robots before the trial
        for disturbance in self._received if number else ():
            if received is not None:
                received = disturbance.received(when, received)
        if received is None:
            return
        self._shown = measured
        if self._under_way:
            received = max(received, self._under_way[-1].observation.received_ns)
        elif self.newest is not None:
            received = max(received, self.newest.received_ns)
        seen = Observation(number, when, received, measured, valid)
        self._under_way.append(Sample(seen, truth))

    def _disturb(self, measured: Poses, when: int) -> tuple[Poses, Bools]:
        """Return the poses as disturbed at a time [ns], and which robots are tracked."""
        valid = self._tracked.copy()
        for disturbance in self._measured:
            measured, valid = disturbance.measured(measured, valid, when / SECOND)
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
