"""Simulates robots on two wheels, see `model.wheels`, with errors drawn at random.

The host computes wheel speeds by equations (24)-(25) at the headings of the newest frame received,
rounds them to wheel counts, and sends them at the radio's rate or once per control step.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from tetractl.core.clock import NEVER, SECOND
from tetractl.core.commands import FieldOff, Steer, Turn
from tetractl.core.poses import Bools, Floats, Observation, Poses, Times
from tetractl.core.setup import Setup
from tetractl.experiment.base import Fraction, Model, NonNegative, Positive
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.model.motion.rolling import MOVING, note
from tetractl.model.wheels import COUNT_MAX, NOTHING, WheeledRobots, nothing_sent, with_room
from tetractl.plant.direct import aim

ONE = np.ones(1, dtype=np.bool_)


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
    """The host of N simulated robots: computes wheel speeds sent, and the resulting true speeds.

    `repeats_ns` is the time of the next transmission [ns]. The generator `erring` draws true gains
    and dead zones, once per trial. `known`, `lag_s`, `sent_ns`, `sent` and `trains` are arguments
    of `kernels.wheels.answer`, for one trial.
    """

    def __init__(
        self, section: WheelDriveSection, setup: Setup, erring: np.random.Generator
    ) -> None:
        from tetractl.control.kernels.wheels import answer

        assert setup.wheel_radius is not None, "the wheels need a radius"
        both, self._answer, self._section = (2, setup.a.size), answer, section
        self.repeats_ns = NEVER
        gains = 1 + section.gain_error * erring.uniform(-1, 1, both)
        more, limit = section.dead_zone_error, 0.0 if section.count is None else COUNT_MAX
        zones = section.dead_zone + erring.integers(-more, more + 1, both)
        gain, ones = section.count or 1.0, np.ones(both)
        truly = gain * gains, np.maximum(zones, 0)
        self.trains = np.array(
            [[0 * ones, gain * ones, section.dead_zone * ones, *truly, limit * ones]]
        )
        self.known = np.array([setup.a, setup.speed, np.full(both[1], setup.wheel_radius)])
        self.lag_s = 0.0 if section.lead is None else setup.lag_s
        sent_ns, sent = nothing_sent(both[1])
        self.sent_ns, self.sent = sent_ns[None], sent[None]
        self._last: tuple[Floats, Floats] | None = None

    def direct(self) -> None:
        """Compute the next speeds for a new direction, rather than repeat the last ones."""
        self._last = None

    def halt(self, now: int) -> None:
        """Hold no direction from now on, because a stop is sent `now` [ns]."""
        self.repeats_ns = NEVER
        self.sent_ns, self.sent = with_room(self.sent_ns, self.sent)
        still = np.zeros_like(self.known[:2])
        note(self.acts_ns(now), still, self.known, self.sent_ns[0], self.sent[0])

    def speeds(
        self, now: int, seen: Observation, held: Steer | Turn | FieldOff
    ) -> tuple[Floats, Floats]:
        """Return the wheel speeds to send `now` [ns], and the resulting true wheel speeds.

        Both are (2, N), left and right [length unit/s]. `seen` is the newest frame received; while
        the field is off, both wheels have equal speeds. Also schedules the next transmission.
        """
        self.repeats_ns = self.next_ns(now)
        if self._last is None or self._section.recompute:
            heading, acts_ns = seen.poses.heading, self.acts_ns(now)
            when = [[acts_ns if self._section.lead is None else seen.sampled_ns], [acts_ns]]
            drives, speeds = (
                np.array([not isinstance(held, Turn)]),
                np.empty((1, 2, *self.known[:2].shape)),
            )
            self.sent_ns, self.sent = with_room(self.sent_ns, self.sent)
            self._answer(
                ONE,
                np.array([heading]),
                np.array([aim(held, heading)]),
                drives,
                *np.array(when),
                self.known,
                self.lag_s,
                self.sent_ns,
                self.sent,
                self.trains,
                speeds,
            )
            self._last = speeds[0, 0], speeds[0, 1]
        return self._last

    def next_ns(self, now: int) -> int:
        """Return the time of the transmission that follows one `now` [ns], as by the lab's inner
        loop."""
        if self._section.rate is None:
            return NEVER
        period = round(SECOND / self._section.rate)
        before = 0 if self.repeats_ns == NEVER else self.repeats_ns
        return max(before + period, now + period // 2)

    def acts_ns(self, now: int) -> int:
        """Return the time [ns] at which the host assumes that a command sent `now` acts."""
        return now + round((self._section.lead or 0.0) * SECOND)


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
        from tetractl.control.kernels.wheels import roll

        assert setup.wheel_radius is not None, "the wheels need a radius"
        self.roll, self.host = roll, SimHost(section, setup, erring)
        self.rest_s = section.lag * -np.log(REST) + 1 / truth_rate
        self.walk, self.walking, self._setup = walk / np.sqrt(truth_rate), walking, setup
        radii = setup.wheel_radius * (1 + section.radius_error * erring.uniform(-1, 1, a.size))
        super().__init__(starts, radii, section.lag, REST * float(setup.speed.max(initial=0.0)))
        self._moving = self.bodies[0, MOVING, :]
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
            drawn = self.walking.standard_normal((1, np.count_nonzero(ticks), len(self._able)))
        return self.drive(since_ns, times, ticks, self.walk, drawn)

    def apply(self, command: DelayedCommand) -> None:
        """Apply a command to the wheels of the robots that received it."""
        assert command.wheels is not None, "the command must have wheel speeds"
        np.copyto(self.targets, command.wheels, where=command.reached)
        self._moving[:] = self.targets.any(axis=0) & self._able
