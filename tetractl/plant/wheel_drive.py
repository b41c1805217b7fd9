"""Simulates robots on two wheels, see `model.wheels`, with errors drawn at random.

The host computes wheel speeds by equations (24)-(25) at the headings of the newest frame received,
rounds them to wheel counts, and sends them at the radio's rate or once per control step.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from tetractl.core.clock import NEVER, SECOND
from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.core.setup import Setup
from tetractl.experiment.base import Fraction, Model, NonNegative, Positive
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.model.motion.rolling import MOVING, note
from tetractl.model.wheels import COUNT_MAX, NOTHING, WheeledRobots, nothing_sent, with_room


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


class SimHost:
    """The host of N robots: computes wheel speeds sent, and the true ones.

    `repeats_ns` is the time of the next transmission [ns]. True gains and dead zones are drawn from
    `erring`. The arrays are those of `wheel_kernel.answer`.
    """

    def __init__(
        self, section: WheelDriveSection, setup: Setup, erring: np.random.Generator
    ) -> None:
        from tetractl.plant.wheel_kernel import answer

        assert setup.wheel_radius is not None, "the wheels need a radius"
        self._answer = answer
        self._section = section
        both = 2, setup.a.size
        gains = 1 + section.gain_error * erring.uniform(-1, 1, both)
        more = section.dead_zone_error
        limit = 0.0 if section.count is None else COUNT_MAX
        zones = section.dead_zone + erring.integers(-more, more + 1, both)
        gain = section.count or 1.0
        rows = 0.0, gain, section.dead_zone, gain * gains, np.maximum(zones, 0), limit
        self.trains = np.array([row + np.zeros(both) for row in rows])
        self._known = np.array([setup.a, setup.speed, np.full(setup.a.size, setup.wheel_radius)])
        self._lag_s = 0.0 if section.lead is None else setup.lag_s
        self._lead_ns = round((section.lead or 0.0) * SECOND)
        self._speeds = np.zeros((2, *both))
        self._sent = nothing_sent(setup.a.size)
        self.repeats_ns = NEVER

    def halt(self, now: int) -> None:
        """Hold no direction from now on, because a stop is sent `now` [ns]."""
        self.repeats_ns = NEVER
        still = np.zeros_like(self._known[:2])
        self._sent = with_room(*self._sent)
        note(now + self._lead_ns, still, self._known, *self._sent)

    def speeds(
        self, new: bool, now_ns: int, heading: Floats, exposed_ns: int, u: Floats, drives: bool
    ) -> Floats:
        """Return the wheel speeds sent at `now_ns` [ns], and the resulting true ones, (2, 2, N),
        the last axes left and right [length unit/s] and N.

        `heading` (N,) is that in the newest frame received, exposed at `exposed_ns`, `u` (N,) the
        direction held, `new` or not; robots that do not `drives` turn on the spot. Also schedules
        the next transmission, as the lab's inner loop does.
        """
        section = self._section
        acts_ns = now_ns + self._lead_ns
        if section.rate is not None:
            period = round(SECOND / section.rate)
            last = 0 if self.repeats_ns == NEVER else self.repeats_ns
            self.repeats_ns = max(last + period, now_ns + period // 2)
        if new or section.recompute:
            self._sent = with_room(*self._sent)
            self._speeds = np.empty_like(self._speeds)
            since_ns = acts_ns if section.lead is None else exposed_ns
            how = drives, since_ns, acts_ns, self._known, self._lag_s, *self._sent, self.trains
            self._answer(heading.copy(), u.copy(), *how, self._speeds)
        return self._speeds


REST = 1e-10
"""Wheels slower than this fraction of the fastest robot's speed count as standing."""


class WheelDrive(WheeledRobots):
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
        from tetractl.plant.wheel_kernel import roll

        assert setup.wheel_radius is not None, "the wheels need a radius"
        self.roll, self.host = roll, SimHost(section, setup, erring)
        self.rest_s = section.lag * -np.log(REST) + 1 / truth_rate
        self.walk, self.walking, self._setup = walk / np.sqrt(truth_rate), walking, setup
        radii = setup.wheel_radius * (1 + section.radius_error * erring.uniform(-1, 1, a.size))
        super().__init__(starts, radii, section.lag, REST * float(setup.speed.max(initial=0.0)))
        self._moving = self.body[MOVING, :]
        self.vary(a, speed)

    @property
    def repeats_ns(self) -> int:
        """The time of the next transmission [ns]."""
        return self.host.repeats_ns

    @property
    def commanded(self) -> Floats:
        """1 for robots whose last command moves them, 0 for others, (N,)."""
        return np.where(self.targets.any(axis=0), 1.0, 0.0)

    @property
    def moving(self) -> Floats:
        """1 for robots that move, 0 for robots that stand, (N,)."""
        return np.copy(self._moving)

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true turning rates a and speeds from now on, (N,) each."""
        known, self._able = self._setup, (a > 0) | (speed > 0)
        scaled = np.divide(speed, known.speed, out=np.ones(speed.size), where=known.speed > 0)
        self.scale(a / known.a, scaled)
        self._moving[:] = self.commanded * self._able

    def advance(self, since_ns: int, times: Times, ticks: Bools) -> Floats:
        """Advance the robots; return x, y, heading (M, 3, N) at the `times` (M,) [ns].

        The heading's random walk is applied at the times at which the true path is sampled, where
        `ticks` (M,) is True.
        """
        drawn = NOTHING
        if self.walk > 0:
            drawn = self.walking.standard_normal((np.count_nonzero(ticks), len(self._able)))
        return self.drive(since_ns, times, ticks, self.walk, drawn)

    def apply(self, command: DelayedCommand) -> None:
        """Apply a command to the wheels of the robots that received it."""
        assert command.wheels is not None, "the command must have wheel speeds"
        np.copyto(self.targets, command.wheels, where=command.reached)
        self._moving[:] = self.targets.any(axis=0) & self._able
