"""Two-wheeled robots in a simulation: wheels that follow what they hear, (21)-(23).

Wheels follow with a first-order lag. Between two transmissions wheel speeds, path length and
heading are known in closed form. The position is the sum of the chords between true samples, each
taken as an arc: with wheels that have settled it is exact, and else its error falls with the square
of the time between samples.
"""

import numpy as np

from tetractl.core.poses import Floats, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.plant.wheel_host import WheelDriveSection, WheelHost

REST = 1e-10
"""Wheels slower than this share of the fastest robot's speed stand."""
SMALL = 0.3
"""Half a turn [rad] below which sin(h)/h is taken from its series, to 1e-9."""


class WheelDrive:
    """N robots on wheels, and their host.

    `a`, `speed` (N,) are the true ones: if they differ from the setup's, turning and speed are
    scaled by the ratio. `walk` [rad/sqrt(s)] is the random walk of the
    heading, at `truth_rate` [Hz], drawn from `walking`; `erring` feeds what is drawn once per
    trial.
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
        assert setup.wheel_radius is not None, "the section's check asks for it"
        self.poses = starts
        self.host = WheelHost(section, setup, erring)
        self.rest_s = section.lag * -np.log(REST) + 1 / truth_rate
        self._lag = section.lag
        self._walk, self._walking = walk / np.sqrt(truth_rate), walking
        self._still = REST * float(setup.speed.max(initial=0.0))
        radii = setup.wheel_radius * (1 + section.radius_error * erring.uniform(-1, 1, count))
        self._setup, self._radii = setup, radii
        self.vary(a, speed)
        self._targets = np.zeros((2, count))  # what the wheels follow, left and right
        self._wheels = np.zeros((2, count))

    @property
    def repeats_ns(self) -> int:
        """When the next transmission is due [ns]."""
        return self.host.repeats_ns

    @property
    def moving(self) -> Floats:
        """1 for robots commanded to move, 0 for those commanded to stand, (N,)."""
        able = (self._turn_of > 0) | (self._way_of > 0)
        return (able & (self._targets != 0).any(axis=0)).astype(np.float64)

    def vary(self, a: Floats, speed: Floats) -> None:
        """Change the true a and speed from now on, (N,) each."""
        known = self._setup
        self._turn_of = a / known.a / (2 * self._radii)  # turning rate of a wheel difference
        nominal = np.ones(speed.size)
        self._way_of = np.divide(speed, known.speed, out=nominal, where=known.speed > 0) / 2

    def advance(self, seconds: Floats, ticks: Floats) -> tuple[Floats, Floats, Floats]:
        """Move on, and return x, y and heading (M, N) after each of the times (M,) from now [s].

        At the times of true samples, where `ticks` (M,) is 1, the heading walks at random.
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
        """Let the wheels of the robots that received a command follow it."""
        assert command.wheels is not None, "every command holds wheel speeds"
        self._targets = np.where(command.reached, command.wheels, self._targets)

    def _follow(self, t: Floats) -> Floats:
        """Return the distances driven by the wheels (M, 2, N) after times t (M, 1, 1), and advance
        to the last."""
        target = self._targets
        if self._lag == 0:
            self._wheels = target
            return target * t
        share = -np.expm1(t / -self._lag)  # of the change, that has happened
        behind = self._wheels - target
        wheels = target + behind * (1 - share[-1])
        if not target.any() and np.abs(wheels).max() < self._still:
            wheels = target
        self._wheels = wheels
        return target * t + (self._lag * behind) * share


def _sinc(half: Floats) -> Floats:
    """Return sin(h)/h, the chord of an arc over its length."""
    if np.abs(half).max() > SMALL:
        return np.sinc(half / np.pi)
    square = half * half
    return 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
