"""The host of simulated robots on wheels: the wheel speeds it sends, and the true speeds."""

from typing import TYPE_CHECKING

import numpy as np

from tetractl.core.clock import NEVER_NS, SECOND, next_due_ns
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
    """The host of N robots on wheels. It computes wheel speeds, and decides when to transmit next.

    The speeds follow equations (24)-(25) at the headings of the newest frame, and are rounded to
    wheel counts.

    Args:
        section: The fields `plant.drive` of the spec.
        setup: The constants of the experiment.
        random: The random generator. It samples first the true gains, then the true dead zones.
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
        """The wheels as the host knows them, and as they truly are."""
        self.gains = np.mean(self.trains.true_gain / self.trains.gain, axis=0)
        """Mean ratio of the true speed of each robot's wheels to the known speed, shape (N,).

        If the two wheels of a robot differ, it also turns while it drives straight.
        """
        self.repeats_ns = NEVER_NS
        """The time of the next transmission of the same action [ns]. NEVER if there is none."""

    def halt(self, now_ns: int) -> None:
        """Stop transmitting wheel speeds, because a stop is sent at `now_ns` [ns]."""
        self.repeats_ns = NEVER_NS
        radius = self._known.radius
        self._sent = self._sent.with_room()
        note(self._sent, now_ns + self._lead_ns, np.zeros((2, radius.size)), radius)

    def transmit(
        self, now_ns: int, action: Steer | Turn | FieldOff, is_new: bool, frame: Observation
    ) -> tuple[Floats, Floats]:
        """Compute the wheel speeds for an action, and schedule the next transmission.

        Args:
            now_ns: The time.
            action: The action.
            is_new: Whether it has not been transmitted before.
            frame: The newest frame received.

        Returns:
            Speeds of left and right wheels, (2, N) each [length unit/s]: first as the host knows
            them from calibrated gains and dead zones, then as the wheels really run.
        """
        if self._section.rate is not None:  # as the lab's inner loop does
            due_ns = 0 if self.repeats_ns == NEVER_NS else self.repeats_ns
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
        if isinstance(action, Steer) and action.lag_s is not None:
            self._known = self._known._replace(lag_s=action.lag_s)
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
    """Sample the wheels of one trial. They have no rounding errors to carry over yet.

    Args:
        section: The section of the wheels.
        robots: Number of robots.
        random: The random generator.
    """
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
