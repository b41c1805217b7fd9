"""Measures a robot by moving it a little: wheel order, gains, dead zones, r, heading offset.

One wheel alone turns the robot about the other: |turning rate| = k (|count| - dead zone) with
k = gain / (2 r), whatever the heading offset. Both wheels together, with counts whose turning
rates cancel, drive it straight at v = r (turning rate of one + of the other): that gives r, and
the direction of travel gives the heading offset and which way is forward. The rigid body's x axis
must point less than a right angle away from the robot's front, after the spec's own offset.
"""

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from tetractl.core.clock import SECOND, MonotonicClock
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Pose
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab import LabSpec, LabWheel
from tetractl.experiment.plants import Calibration, RobotCalibration
from tetractl.lab.actuators.m3pi.broadcast import Counts
from tetractl.lab.guard import Guard
from tetractl.lab.rig import Session

FIRST, STEP = 6, 4  # counts of the ramp
BURST_S = 0.4
SETTLING_S = 0.2  # of a burst, until the wheels turn steadily
STRAIGHT_S = 0.7
TURNS = 0.25  # rad/s: slower is not turning
ROAM_MM = 300.0  # a robot never gets further from where it stood
POINTS = 3  # speeds a line is fitted through, at least
GAP_NS = 60_000_000  # between frames of a burst
TRIES = 4
SILENCE_NS = 3 * SECOND


@dataclass(frozen=True, slots=True)
class Motion:
    """Steady motion: turning rate [rad/s], and speed along and left of the heading [mm/s]."""

    turning: float
    along: float
    across: float


@dataclass(frozen=True, slots=True)
class Channel:
    """One motor channel: it turns the robot by `sign` k (|count| - dead zone) on counts > 0."""

    sign: int
    k: float
    dead_zone: int

    def count(self, turning: float) -> int:
        """Return the count, not signed, that turns the robot at a rate."""
        return round(turning / self.k) + self.dead_zone


def calibrate_robots(
    experiment: Experiment,
    lab: LabSpec,
    names: Sequence[str],
    limit: int,
    operator: threading.Event,
    tell: Callable[[str], None],
) -> Calibration:
    """Measure robots one after another; AbortError says which would not be measured and why."""
    found: list[RobotCalibration] = []
    for name in names:
        tell(f"{name}: measuring")
        alone = tuple(robot for robot in experiment.robots if robot.name == name)
        bench = _Bench(experiment.model_copy(update={"robots": alone}), lab, limit, operator)
        try:
            bench.open()
            found.append(bench.measure())
        finally:
            bench.close()
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return Calibration(measured=now, robots=tuple(found))


@dataclass(slots=True)
class _Trace:
    """The poses of one burst, with their times [ns]."""

    poses: list[tuple[int, Pose]] = field(default_factory=list)


class _Bench:
    """One robot under measurement; the guard watches as in a run."""

    def __init__(
        self, experiment: Experiment, lab: LabSpec, limit: int, operator: threading.Event
    ) -> None:
        self.clock = MonotonicClock()
        self.name = experiment.robots[0].name
        self.limit = limit
        self._trace = _Trace()
        self._home: Pose | None = None
        session = self.session = Session(
            experiment, lab, self.clock, operator, on_snapshot=self._see
        )
        self.robot = session.lab.robots[0]
        self.limit = min(limit, session.bodies[0].drivetrain.limit)
        session.guard.rules = replace(
            session.guard.rules,
            speeds=(500.0 / session.mm,),
            turning=(12.0,),
            silence_ns=SILENCE_NS,
        )

    def open(self) -> None:
        """Connect; the robot must be tracked and answer."""
        session = self.session
        session.open()
        if session.client.stream.missing():
            raise AbortError(f"the cameras know no rigid body {self.robot.body}")
        (answer,) = session.voice.poll(1.0)
        if answer is None:
            raise AbortError(f"{self.name} does not answer", "see `tetractl lab check`")
        session.guard.ready()

    def close(self) -> None:
        """Stop the robot and let go."""
        self.session.drive.stop()
        self.session.close()

    def measure(self) -> RobotCalibration:
        """Do all of it."""
        channels = [self._channel(0), self._channel(1)]
        turning = 0.6 * min(channel.k * (self.limit - channel.dead_zone) for channel in channels)
        sizes = [channel.count(turning) for channel in channels]
        # signs under which the two turning rates cancel
        signs = [1, -channels[0].sign * channels[1].sign]
        away = self._run(_pair(signs, sizes), STRAIGHT_S)
        back = self._run(_pair([-sign for sign in signs], sizes), STRAIGHT_S)
        here = away
        if away.along < 0:
            here, back = back, away
            signs = [-sign for sign in signs]
        self._stand()
        speed = math.hypot(here.along, here.across)
        rates = [c.k * (size - c.dead_zone) for c, size in zip(channels, sizes, strict=True)]
        radius = speed / sum(rates)
        if not 5.0 < radius < 500.0:
            raise AbortError(f"{self.name}: r would be {radius:.0f} mm; does it roll freely?")
        offset = math.atan2(here.across - back.across, here.along - back.along)
        if abs(offset) > math.pi / 3:
            raise AbortError(
                f"{self.name}: its rigid body points {math.degrees(offset):.0f} degrees off its "
                "front",
                "give heading_offset roughly in the spec, or define the rigid body anew",
            )
        wheels = [
            LabWheel(gain_mm=2 * radius * c.k, dead_zone=c.dead_zone, invert=sign < 0)
            for c, sign in zip(channels, signs, strict=True)
        ]
        swap = channels[0].sign * signs[0] > 0  # forward on the right turns left
        left, right = reversed(wheels) if swap else wheels
        whole = math.remainder(self.robot.heading_offset + offset, math.tau)
        return RobotCalibration(
            name=self.name,
            heading_offset=round(whole, 5),
            radius_mm=round(radius, 3),
            left=_rounded(left),
            right=_rounded(right),
            swap=swap,
        )

    def _channel(self, which: int) -> Channel:
        """Ramp one channel, to and fro; fit turning rates against counts."""
        points: list[tuple[int, float]] = []
        signs: list[float] = []
        for count in range(FIRST, self.limit + 1, STEP):
            rates = []
            for sign in (1, -1):
                counts = [0, 0]
                counts[which] = sign * count
                rates.append(sign * self._run((counts[0], counts[1]), BURST_S).turning)
            rate = sum(rates) / 2
            if abs(rate) > TURNS:
                points.append((count, abs(rate)))
                signs.append(rate)
        self._stand()
        if len(points) < POINTS:
            raise AbortError(
                f"{self.name}: channel {which + 1} hardly moves it up to {self.limit} counts",
                "is its battery charged, is the motor connected? or raise --limit",
            )
        counts, rates = np.array(points).T
        slope, start = np.polyfit(counts, rates, 1)
        if slope <= 0 or len({rate > 0 for rate in signs}) > 1:
            raise AbortError(f"{self.name}: channel {which + 1} does not turn it steadily")
        dead = min(60, max(0, round(-start / slope)))
        steps = counts - dead
        return Channel(1 if signs[0] > 0 else -1, float(steps @ rates / (steps @ steps)), dead)

    def _run(self, counts: Counts, seconds: float) -> Motion:
        """Hold counts for a while; return the motion once it is steady.

        Again, where frames were missing: the guard may have stopped the robot meanwhile.
        """
        for _ in range(TRIES):
            self._trace = trace = _Trace()
            began = self.session.drive.hold((counts,)).t_ns
            end = began + round(seconds * SECOND)
            self.clock.sleep_until(end)
            if self.session.guard.reason:
                raise AbortError(f"{self.name}: {self.session.guard.reason}")
            seen = [(t, pose) for t, pose in tuple(trace.poses) if t >= began]
            times = [began, *(t for t, _ in seen), end]
            if max(np.diff(times)) <= GAP_NS:
                return _steady(seen, began + round(SETTLING_S * SECOND), self.session.mm)
            self.session.drive.hold((_pair((-1, -1), counts),))  # back, so that it stays near
            self.clock.sleep_until(self.clock.now() + end - began)
        raise AbortError(f"{self.name}: frames are missing again and again")

    def _stand(self) -> None:
        self.session.drive.hold(((0, 0),))
        self.clock.sleep_until(self.clock.now() + SECOND // 4)

    def _see(self, snapshot: CameraFrame, guard: Guard) -> None:
        ((pose, here),) = guard.believed(snapshot)
        if pose is None or not here:
            return
        self._home = self._home or pose
        away = math.hypot(pose.x - self._home.x, pose.y - self._home.y) * self.session.mm
        if away > ROAM_MM:
            guard.abort(f"{away:.0f} mm away from where it stood")
        self._trace.poses.append((snapshot.sampled_ns, pose))


def _steady(poses: list[tuple[int, Pose]], since_ns: int, mm: float) -> Motion:
    """Fit a turning rate and a velocity in the robot's own frame to poses."""
    seen = [(t, pose) for t, pose in poses if t >= since_ns]
    t = np.array([t for t, _ in seen]) / SECOND
    x, y, raw = np.array([(p.x, p.y, p.heading) for _, p in seen]).T
    heading = np.unwrap(raw)
    turning = float(np.polyfit(t - t[0], heading, 1)[0])
    middle = (heading[1:] + heading[:-1]) / 2
    dx, dy = np.diff(x) * mm, np.diff(y) * mm
    span = t[-1] - t[0]
    along = float(np.sum(dx * np.cos(middle) + dy * np.sin(middle)) / span)
    across = float(np.sum(dy * np.cos(middle) - dx * np.sin(middle)) / span)
    return Motion(turning, along, across)


def _pair(signs: Sequence[int], sizes: Sequence[int]) -> Counts:
    return signs[0] * sizes[0], signs[1] * sizes[1]


def _rounded(wheel: LabWheel) -> LabWheel:
    return wheel.model_copy(update={"gain_mm": round(wheel.gain_mm, 4)})
