"""Simulates robots on two wheels that follow commands, by the paper's equations (21)-(23).

Wheels follow commands with a first-order lag. Between two transmissions, wheel speeds, path length
and heading are known in closed form. The position is the sum of the chords between the successive
times at which it is computed, each taken as the chord of an arc: exact for settled wheels;
otherwise the error falls with the square of the time between them.

The host computes wheel speeds by equations (24)-(25) at the headings of the newest frame received,
rounds them to wheel counts, and sends them at the radio's rate or once per control step.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Fraction, Model, NonNegative, Positive
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.model.motion.exact import step as exact
from tetractl.model.wheels import (
    Drivetrain,
    LaggingTurns,
    Residue,
    Wheel,
    body_velocity,
    speeds_of_counts,
    wheel_counts,
    wheel_speeds,
)
from tetractl.plant.direct import NEVER


class WheelDriveSection(Model):
    """Wheels that carry out the direction; the defaults describe ideal wheels."""

    rate: Positive | None = None
    """Transmissions per second under a held direction [Hz]. Each new direction is sent at once; by
    default there are no further transmissions.
    """
    recompute: bool = True
    """Whether the host computes the wheel speeds of each transmission from the newest frame;
    otherwise it repeats the wheel speeds of the control step.
    """
    lead: NonNegative | None = None
    """The host predicts the headings this time after sending a command [s], and computes its wheel
    speeds for them; with `wheels.lag`, it predicts the headings in which robots stopped at that
    time come to rest. By default it uses the measured headings."""
    count: Positive | None = None
    """Wheel speed of one count [length unit/s]: speeds are rounded to whole counts, and the
    rounding error is carried to the next transmission. Not rounded by default."""
    dead_zone: Annotated[int, Field(ge=0, le=60)] = 0
    """Largest count at which the host assumes that a wheel does not move; needs `count`."""
    dead_zone_error: Annotated[int, Field(ge=0, le=60)] = 0
    """Largest difference of a wheel's true dead zone from `dead_zone` [counts]; the difference is
    drawn uniformly from the whole numbers in [-dead_zone_error, dead_zone_error].
    """
    gain_error: Fraction = 0.0
    """Each wheel's true speed is the speed sent times 1 + e, with e uniform in [-gain_error,
    gain_error], drawn once per trial."""
    radius_error: Fraction = 0.0
    """Each robot's true distance from wheel to centre is the spec's times 1 + e, with e uniform in
    [-radius_error, radius_error], drawn once per trial.
    """
    lag: NonNegative = 0.0
    """Time constant with which wheels follow a received command [s]."""


class WheelHost:
    """Computes the wheel speeds sent to N robots, and the resulting true wheel speeds.

    `repeats_ns` is the time of the next transmission [ns]. `direction` is the held direction [rad],
    None while the field is off: both wheels then have equal speeds. If `ahead` is False, robots
    turn on the spot. The generator `erring` draws true gains and dead zones, once per trial.
    """

    def __init__(
        self, section: WheelDriveSection, setup: Setup, erring: np.random.Generator
    ) -> None:
        assert setup.wheel_radius is not None, "the wheels need a radius"
        count = setup.a.size
        self.repeats_ns = NEVER
        self.direction: float | None = 0.0
        self.ahead = True
        self._section = section
        self._a, self._speed, self._radius = setup.a, setup.speed, setup.wheel_radius
        self._gains = 1 + section.gain_error * erring.uniform(-1, 1, (2, count))
        more = section.dead_zone_error
        zones = section.dead_zone + erring.integers(-more, more + 1, (2, count))
        # wheels as assumed by the host, and true wheels
        self._trains: list[tuple[Drivetrain, Drivetrain]] = []
        if section.count is not None:
            known = Wheel(section.count, section.dead_zone)
            true = [
                [
                    Wheel(section.count * float(self._gains[i, j]), max(0, int(zones[i, j])))
                    for i in (0, 1)
                ]
                for j in range(count)
            ]
            self._trains = [
                (Drivetrain(known, known), Drivetrain(left, right)) for left, right in true
            ]
        self._residues = [Residue()] * count
        # predicts headings if the spec has a lag of the wheels
        self._turns = LaggingTurns(setup.lag_s, count) if setup.lag_s > 0 else None
        self._last: tuple[Floats, Floats] | None = None

    def direct(self, direction: float | None, ahead: bool = True) -> None:
        """Hold a direction u [rad] from now on, None for no field.

        The caller sends wheel speeds for this direction at once.
        """
        self.direction, self.ahead, self._last = direction, ahead, None

    def halt(self, now: int) -> None:
        """Hold no direction from now on, because a stop is sent `now` [ns]."""
        self.repeats_ns = NEVER
        if self._turns is not None:
            self._turns.sent(self._acts_ns(now), np.zeros_like(self._a))

    def speeds(self, now: int, seen: Observation) -> tuple[Floats, Floats]:
        """Return the wheel speeds to send `now` [ns], and the resulting true wheel speeds.

        Both are (2, N), left and right [length unit/s]. `seen` is the newest frame received. Also
        schedules the next transmission, as the lab's inner loop does.
        """
        rate = self._section.rate
        if rate is not None:
            period = round(SECOND / rate)
            before = 0 if self.repeats_ns == NEVER else self.repeats_ns
            self.repeats_ns = max(before + period, now + period // 2)
        if self._last is None or self._section.recompute:
            self._last = self._computed(now, seen)
        return self._last

    def _computed(self, now: int, seen: Observation) -> tuple[Floats, Floats]:
        """Return the wheel speeds sent, by equations (24)-(25), and the resulting true speeds."""
        heading = seen.poses.heading
        u = heading if self.direction is None else np.array(self.direction)
        if self._turns is not None and self._section.lead is not None:
            heading = self._turns.ahead(heading, seen.sampled_ns, self._acts_ns(now))
        elif self._section.lead is not None:
            ahead = (now - seen.sampled_ns) / SECOND + self._section.lead
            nowhere = np.zeros_like(heading)
            _, _, heading = exact(nowhere, nowhere, heading, u, self._a, self._speed, ahead)
        speed = self._speed * self.ahead
        wished = np.array(wheel_speeds(heading, u, self._a, speed, self._radius))
        if self._turns is not None:
            _, turning = body_velocity(wished[0], wished[1], self._radius)
            self._turns.sent(self._acts_ns(now), turning)
        if not self._trains:
            return wished, wished * self._gains
        sent, made = [], []
        for i, ((left, right), (told, true)) in enumerate(
            zip(wished.T.tolist(), self._trains, strict=True)
        ):
            counts, self._residues[i] = wheel_counts(left, right, told, self._residues[i])
            sent.append(speeds_of_counts(counts, told))
            made.append(speeds_of_counts(counts, true))
        return np.array(sent).T, np.array(made).T

    def _acts_ns(self, now: int) -> int:
        """Return the time [ns] at which the host assumes that a command sent `now` acts."""
        return now + round((self._section.lead or 0.0) * SECOND)


REST = 1e-10
"""Wheels slower than this fraction of the fastest robot's speed count as standing."""
SMALL = 0.3
"""Angle h [rad] below which sin(h)/h is computed by its series, to 1e-9."""


class WheelDrive:
    """Moves N robots on wheels; `host` computes the wheel speeds sent to them.

    `a` and `speed` (N,) are the true values: turning rates and speeds are scaled by the ratio of
    the true value to the setup's value. The generator `walking` draws the random walk of the
    heading, `walk` [rad/sqrt(s)], at `truth_rate` [Hz]; `erring` draws values that are constant in
    a trial.
    """

    sampled = True  # the path is a sum over samples

    def __init__(
        self,
        section: WheelDriveSection,
        setup: Setup,
        a: Floats,
        speed: Floats,
        starts: Poses,
        walk: float,
        truth_rate: float,
        walking: np.random.Generator,
        erring: np.random.Generator,
    ) -> None:
        count = a.size
        assert setup.wheel_radius is not None, "the wheels need a radius"
        self.poses = starts
        self.host = WheelHost(section, setup, erring)
        self.rest_s = section.lag * -np.log(REST) + 1 / truth_rate
        self._lag = section.lag
        self._walk, self._walking = walk / np.sqrt(truth_rate), walking
        self._still = REST * float(setup.speed.max(initial=0.0))
        radii = setup.wheel_radius * (1 + section.radius_error * erring.uniform(-1, 1, count))
        self._setup, self._radii = setup, radii
        self.vary(a, speed)
        self._targets = np.zeros((2, count))  # speeds that the left and right wheels follow
        self._wheels = np.zeros((2, count))

    @property
    def repeats_ns(self) -> int:
        """The time of the next transmission [ns]."""
        return self.host.repeats_ns

    @property
    def commanded(self) -> Floats:
        """1 for robots whose last command moves them, 0 for others, (N,)."""
        return (self._targets != 0).any(axis=0).astype(np.float64)

    @property
    def moving(self) -> Floats:
        """1 for robots that move, 0 for robots that stand, (N,)."""
        return self.commanded * ((self._turn_of > 0) | (self._way_of > 0))

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a and speeds from now on, (N,) each."""
        known = self._setup
        # turning rate per difference of wheel speeds
        self._turn_of = a / known.a / (2 * self._radii)
        nominal = np.ones(speed.size)
        self._way_of = np.divide(speed, known.speed, out=nominal, where=known.speed > 0) / 2

    def advance(self, seconds: Floats, ticks: Floats) -> tuple[Floats, Floats, Floats]:
        """Advance the robots; return x, y, heading (M, N) at the times `seconds` (M,) from now.

        The heading's random walk is applied at the times at which the true path is sampled, where
        `ticks` (M,) is 1.
        """
        p = self.poses
        ways = self._follow(seconds[:, None, None])
        turned = self._turn_of * (ways[:, 1] - ways[:, 0])
        gone = self._way_of * (ways[:, 1] + ways[:, 0])
        half, way = turned / 2, gone.copy()
        half[1:] -= turned[:-1] / 2
        way[1:] -= gone[:-1]
        heading = p.heading + turned
        middle = heading - half
        if self._walk > 0:
            drawn = self._walking.standard_normal((np.count_nonzero(ticks), way.shape[1]))
            steps = np.zeros_like(way)
            steps[ticks > 0] = self._walk * drawn * self.moving
            walks = steps.cumsum(axis=0)
            heading += walks
            middle[1:] += walks[:-1]
        chord = way * _sinc(half)
        x = p.x + (chord * np.cos(middle)).cumsum(axis=0)
        y = p.y + (chord * np.sin(middle)).cumsum(axis=0)
        self.poses = Poses(x[-1], y[-1], heading[-1])
        return x, y, heading

    def apply(self, command: DelayedCommand) -> None:
        """Apply a command to the wheels of the robots that received it."""
        assert command.wheels is not None, "the command must have wheel speeds"
        self._targets = np.where(command.reached, command.wheels, self._targets)

    def _follow(self, t: Floats) -> Floats:
        """Return the distances driven by the wheels (M, 2, N) up to the times t (M, 1, 1) from now,
        and advance the wheel speeds to the last of these times.
        """
        target = self._targets
        if self._lag == 0:
            self._wheels = target
            return target * t
        share = -np.expm1(t / -self._lag)  # completed fraction of the change
        behind = self._wheels - target
        wheels = target + behind * (1 - share[-1])
        if not target.any() and np.abs(wheels).max() < self._still:
            wheels = target
        self._wheels = wheels
        return target * t + (self._lag * behind) * share


def _sinc(half: Floats) -> Floats:
    """Return sin(h)/h, the ratio of an arc's chord to its length, for half the arc's angle h."""
    if np.abs(half).max() > SMALL:
        return np.sinc(half / np.pi)
    square = half * half
    return 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
