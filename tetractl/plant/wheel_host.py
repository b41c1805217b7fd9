"""The host of simulated robots on wheels: what it sends, and how fast wheels then turn in truth."""

from typing import TYPE_CHECKING

import numpy as np

from tetractl.core.clock import NEVER, SECOND, next_due_ns
from tetractl.core.commands import FieldOff, Steer, Turn
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.model.motion.rolling import KnownRobots, SentRates, note
from tetractl.model.wheels import COUNT_MAX
from tetractl.plant.direct import aim
from tetractl.plant.sim_section import WheelDriveSection

if TYPE_CHECKING:
    from tetractl.plant.drive_kernels import Trains


class SimHost:
    """Computes the wheel speeds of N robots by equations (24)-(25) at the headings of the newest
    frame, rounds them to wheel counts, and says when it transmits next.

    `random` draws the true gains, then the true dead zones.
    """

    def __init__(
        self, section: WheelDriveSection, setup: Setup, random: np.random.Generator
    ) -> None:
        from tetractl.plant.drive_kernels import answer  # late: compiled

        assert setup.wheel_radius is not None, "the wheels need a radius"
        robots = setup.a.size
        self._answer = answer
        self._section = section
        self._known = KnownRobots(
            a=setup.a.copy(),
            speed=setup.speed.copy(),
            radius=np.full(robots, setup.wheel_radius),
            lag_s=0.0 if section.lead is None else setup.lag_s,
        )
        self._lead_ns = round((section.lead or 0.0) * SECOND)
        self._sent = SentRates.none(robots)
        self._speeds = np.zeros((2, robots)), np.zeros((2, robots))
        """The wheel speeds of the last transmission, as `transmit` returns them."""
        self.trains = true_trains(section, robots, random)
        """Wheels as calibrated and in truth."""
        self.gains = np.mean(self.trains.true_gain / self.trains.gain, axis=0)
        """By how much robots drive and turn faster than sent, (N,); where the two wheels differ,
        the robot turns on its way, too: its heading bias."""
        self.repeats_ns = NEVER
        """The time of the next transmission of the same action [ns]."""

    def halt(self, now_ns: int) -> None:
        """Transmit nothing more from now on, because a stop is sent."""
        self.repeats_ns = NEVER
        radius = self._known.radius
        self._sent = self._sent.with_room()
        note(self._sent, now_ns + self._lead_ns, np.zeros((2, radius.size)), radius)

    def transmit(
        self, now_ns: int, action: Steer | Turn | FieldOff, is_new: bool, frame: Observation
    ) -> tuple[Floats, Floats]:
        """Return the wheel speeds sent `now_ns` for an action, and schedule the next transmission.

        Of left and right wheels, (2, N) each [length unit/s]: as the host knows them, by calibrated
        gains and dead zones, and as the wheels run in truth. `frame` is the newest one received;
        `is_new` if the action has not been transmitted before.
        """
        if self._section.rate is not None:  # as the lab's inner loop does
            due_ns = 0 if self.repeats_ns == NEVER else self.repeats_ns
            self.repeats_ns = next_due_ns(due_ns, now_ns, round(SECOND / self._section.rate))
        if is_new or self._section.recompute:
            self._compute(now_ns + self._lead_ns, action, frame)
        return self._speeds

    def _compute(self, acts_ns: int, action: Steer | Turn | FieldOff, frame: Observation) -> None:
        """Compute the wheel speeds that begin to act at `acts_ns`."""
        measured_ns = frame.sampled_ns
        if self._section.lead is None:  # headings are taken as those of that time
            measured_ns = acts_ns
        headings = frame.poses.heading.copy()  # a read-only array is another type to the kernel
        self._sent = self._sent.with_room()
        self._speeds = self._answer(
            heading=headings,
            u=aim(action, headings),
            since_ns=measured_ns,
            acts_ns=acts_ns,
            robots=self._known.turning() if isinstance(action, Turn) else self._known,
            sent=self._sent,
            trains=self.trains,
        )


def true_trains(section: WheelDriveSection, robots: int, random: np.random.Generator) -> "Trains":
    """Return the wheels of one trial; nothing is owed yet."""
    from tetractl.plant.drive_kernels import Trains

    wheels = (2, robots)
    gain = 1.0 if section.count is None else section.count
    # in this order: it is part of the result
    gain_factors = 1 + section.gain_error * random.uniform(-1, 1, wheels)
    zone_error = section.dead_zone_error
    dead_zones = section.dead_zone + random.integers(-zone_error, zone_error + 1, wheels)
    return Trains(
        owed=np.zeros(wheels),
        gain=np.full(wheels, float(gain)),
        dead_zone=np.full(wheels, float(section.dead_zone)),
        true_gain=gain * gain_factors,
        true_dead_zone=np.maximum(dead_zones, 0.0),
        limit=np.full(robots, 0.0 if section.count is None else float(COUNT_MAX)),
    )
