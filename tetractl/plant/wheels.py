"""Two-wheeled robots in a simulation: wheel speeds computed at the host, sent, and driven.

The host computes (24)-(25) from the newest frame that it has received, rounds to wheel counts and
sends them, anew at the radio's rate or once a control step. Each robot's wheels follow what it
hears with a first-order lag, gains, dead zones and a wheel distance of their own, and the robot
moves by (21)-(23).

Between two transmissions wheel speeds, way and heading are known in closed form. The position is
the sum of the chords between true samples, each taken as an arc: with wheels that have settled it
is exact, and else its error falls with the square of the time between samples.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Fraction, Model, NonNegative, Positive
from tetractl.experiment.disturbance import Order
from tetractl.lab.actuators.m3pi.command import (
    Drivetrain,
    Residue,
    Wheel,
    speeds_of_counts,
    wheel_counts,
)
from tetractl.model.motion.exact import step as exact
from tetractl.model.wheels import wheel_speeds
from tetractl.plant.direct import NEVER

REST = 1e-10
"""Wheels slower than this share of the fastest robot's speed stand."""

Speeds = tuple[Floats, Floats]
"""Left and right wheel speeds (N,) [length unit/s]."""


class WheelDriveSection(Model):
    """Wheels between the direction and the robots. Every value left out is that of ideal wheels."""

    rate: Positive | None = None
    """Transmissions a second under a held direction [Hz]. One is sent at once with each new
    direction, and by default only that; with a rate, it takes the place of the next one due."""
    recompute: bool = True
    """Whether each transmission computes the wheel speeds anew from the newest frame; else it
    repeats those of the control step."""
    lead: NonNegative | None = None
    """The host predicts the headings over the age of the frame and this much more [s]; by default
    it takes them as measured."""
    count: Positive | None = None
    """Wheel speed of one count [length unit/s]: speeds are rounded to whole counts, and what
    rounding owes is carried to the next transmission. Not rounded by default."""
    dead_zone: Annotated[int, Field(ge=0, le=60)] = 0
    """Counts that do not move a wheel, as the host knows them; needs `count`."""
    dead_zone_error: Annotated[int, Field(ge=0, le=60)] = 0
    """Each wheel's true dead zone is that plus a whole number, uniform up to this either way."""
    gain_error: Fraction = 0.0
    """Each wheel's true speed is the one sent times 1 + e, e uniform in [-gain_error,
    gain_error], drawn once a trial."""
    radius_error: Fraction = 0.0
    """Each robot's true distance from wheel to centre is the spec's times 1 + e, likewise."""
    lag: NonNegative = 0.0
    """Time constant with which wheels follow what was heard [s]."""


class WheelDrive:
    """N robots on wheels, and the host's side of them.

    `a`, `speed` (N,) are the true ones: where they differ from the setup's, the robot turns, and
    drives, by so much more than its wheels make it. `walk` [rad/sqrt(s)] is the random walk of the
    heading, at `truth_rate` [Hz], drawn from `walking`; `erring` feeds what is drawn once a trial.
    """

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
        assert setup.wheel_radius is not None, "the section's check asks for it"
        self.poses = starts
        self.repeats_ns = NEVER
        self.rest_s = section.lag * -np.log(REST) + 1 / truth_rate
        self._section, self._setup = section, setup
        self._a, self._speed, self._radius = setup.a, setup.speed, setup.wheel_radius
        self._walk, self._walking = walk / np.sqrt(truth_rate), walking
        self._still = REST * float(setup.speed.max(initial=0.0))
        gains = 1 + section.gain_error * erring.uniform(-1, 1, (2, count))
        radii = self._radius * (1 + section.radius_error * erring.uniform(-1, 1, count))
        more = section.dead_zone_error
        zones = section.dead_zone + erring.integers(-more, more + 1, (2, count))
        self._turn_of = a / setup.a / (2 * radii)  # turning rate of a difference of wheel speeds
        self._way_of = np.divide(speed, setup.speed, out=np.ones(count), where=setup.speed > 0) / 2
        self._gains = gains[0], gains[1]
        self._told: list[Drivetrain] = []
        self._true: list[Drivetrain] = []
        if section.count is not None:
            step = section.count
            known = Wheel(step, section.dead_zone)
            self._told = [Drivetrain(known, known)] * count
            wheels = [
                [Wheel(step * float(gains[i, j]), max(0, int(zones[i, j]))) for i in (0, 1)]
                for j in range(count)
            ]
            self._true = [Drivetrain(left, right) for left, right in wheels]
        self._residues = [Residue()] * count
        self._targets: Speeds = np.zeros(count), np.zeros(count)  # what the wheels follow
        self._wheels: Speeds = np.zeros(count), np.zeros(count)
        self.direction = 0.0
        """The direction held [rad]."""
        self._last: tuple[Speeds, Speeds] | None = None

    @property
    def moving(self) -> Floats:
        """1 for robots told to move, 0 for those told to stand, (N,)."""
        return np.asarray((self._targets[0] != 0) | (self._targets[1] != 0), dtype=np.float64)

    def direct(self, direction: float) -> None:
        """Hold a direction u [rad] from now on; wheel speeds for it have to be sent at once."""
        self.direction, self._last = direction, None

    def halt(self) -> None:
        """Hold no direction any more."""
        self.repeats_ns = NEVER

    def speeds(self, now: int, seen: Observation) -> tuple[Speeds, Speeds]:
        """Return the wheel speeds to send `now` [ns], and those that they truly make.

        `seen` is the newest frame received. The next transmission is planned.
        """
        section = self._section
        if section.rate is None:
            self.repeats_ns = NEVER
        else:  # as the lab's inner loop does
            period = round(SECOND / section.rate)
            before = 0 if self.repeats_ns == NEVER else self.repeats_ns
            self.repeats_ns = max(before + period, now + period // 2)
        if self._last is None or section.recompute:
            self._last = self._computed(now, seen)
        return self._last

    def glide(self, seconds: Floats, ticks: Floats) -> tuple[Floats, Floats, Floats]:
        """Move on, and return x, y and heading (M, N) after each of the times (M,) from now [s].

        At the times of true samples, where `ticks` (M,) is 1, the heading walks at random.
        """
        t = np.concatenate([[0.0], seconds])[:, None]
        (left, lefts), (right, rights) = (
            self._followed(wheel, target, t)
            for wheel, target in zip(self._wheels, self._targets, strict=True)
        )
        turned = self._turn_of * (rights - lefts)
        way = np.diff(self._way_of * (rights + lefts), axis=0)
        if self._walk > 0:
            walked = self._walk * self._walking.standard_normal((int(ticks.sum()), left.size))
            steps = np.zeros_like(way)
            steps[ticks > 0] = walked * self.moving
            walks = np.vstack([np.zeros(left.size), np.cumsum(steps, axis=0)])
        else:
            walks = np.zeros((1, left.size))
        p = self.poses
        half = np.diff(turned, axis=0) / 2
        middle = p.heading + turned[:-1] + half + (walks[:-1] if self._walk > 0 else walks)
        chord = way * np.sinc(half / np.pi)
        x = p.x + np.cumsum(chord * np.cos(middle), axis=0)
        y = p.y + np.cumsum(chord * np.sin(middle), axis=0)
        heading = (p.heading + turned + walks)[1:]
        self.poses = Poses(x[-1], y[-1], heading[-1])
        if not (np.abs(left) + np.abs(right) >= self._still).any() and not self.moving.any():
            left, right = np.zeros_like(left), np.zeros_like(right)
        self._wheels = left, right
        return x, y, heading

    def take(self, order: Order) -> None:
        """Let the wheels of the robots that received an order follow it."""
        assert order.wheels is not None, "every order holds wheel speeds"
        got = order.reached
        pairs = zip(order.wheels, self._targets, strict=True)
        left, right = (np.where(got, new, old) for new, old in pairs)
        self._targets = left, right

    def _followed(self, speed: Floats, target: Floats, t: Floats) -> tuple[Floats, Floats]:
        """Return a wheel's speed (N,) at the last of the times t (M, 1) and its ways (M, N)."""
        lag = self._section.lag
        if lag == 0:
            return target, target * t
        gone = -np.expm1(-t / lag)  # share of the change that has happened
        behind = speed - target
        return target + behind * (1 - gone[-1]), target * t + behind * (lag * gone)

    def _computed(self, now: int, seen: Observation) -> tuple[Speeds, Speeds]:
        """Return the wheel speeds of (24)-(25) as sent, and as the wheels truly make them."""
        u, heading = self.direction, seen.poses.heading
        if self._section.lead is not None:
            ahead = (now - seen.sampled_ns) / SECOND + self._section.lead
            nowhere = np.zeros_like(heading)
            _, _, heading = exact(
                nowhere, nowhere, heading, np.array(u), self._a, self._speed, ahead
            )
        left, right = wheel_speeds(heading, u, self._a, self._speed, self._radius)
        if not self._told:
            return (left, right), (left * self._gains[0], right * self._gains[1])
        sent, made = [], []
        for i, (told, true) in enumerate(zip(self._told, self._true, strict=True)):
            wished = float(left[i]), float(right[i])
            counts, self._residues[i] = wheel_counts(*wished, told, self._residues[i])
            sent.append(speeds_of_counts(counts, told))
            made.append(speeds_of_counts(counts, true))
        (left, right), (true_left, true_right) = np.array(sent).T, np.array(made).T
        return (left, right), (true_left, true_right)
