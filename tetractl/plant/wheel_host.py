"""The host of simulated robots on wheels: the wheel speeds that it sends, and the true speeds."""

from typing import TYPE_CHECKING

import numpy as np

from tetractl.core.clock import NEVER_NS, SECOND, next_due_ns
from tetractl.core.commands import FieldOff, Steer, Turn
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.model.motion.rolling import KnownRobots, SentRates, note
from tetractl.model.wheels import COUNT_MAX
from tetractl.plant.direct import find_aimed_directions
from tetractl.plant.sim_section import WheelDriveSection

if TYPE_CHECKING:
    from tetractl.plant.drive_kernels import WheelArrays


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
        from tetractl.plant.drive_kernels import compute_wheel_speeds  # late: compiled

        assert setup.wheel_radius is not None, "the wheels need a radius"
        n_robots = setup.a.size
        self._compute_speeds = compute_wheel_speeds
        self._section = section
        self._known_robots = KnownRobots(
            a=setup.a.copy(),
            speed=setup.speed.copy(),
            radius=np.full(n_robots, setup.wheel_radius),
            lag_s=0.0 if section.lead is None else setup.lag_s,
        )
        self._lead_ns = round((section.lead or 0.0) * SECOND)
        self._sent_rates = SentRates.none(n_robots)
        self._last_speeds = np.zeros((2, n_robots)), np.zeros((2, n_robots))
        """The wheel speeds of the last transmission, as `transmit` returns them."""
        self.drivetrains = sample_drivetrains(section, n_robots, random)
        """The wheels as the host knows them, and as they truly are."""
        self.gains = np.mean(self.drivetrains.true_gain / self.drivetrains.gain, axis=0)
        """Mean ratio of the true speed of each robot's wheels to the known speed, shape (N,).

        If the two wheels of a robot differ, it also turns while it drives straight.
        """
        self.next_repeat_ns = NEVER_NS
        """The time of the next transmission of the same action [ns]. NEVER_NS if there is none."""

    def halt(self, now_ns: int) -> None:
        """Stop transmitting wheel speeds, because a stop is sent at `now_ns` [ns]."""
        self.next_repeat_ns = NEVER_NS
        radius = self._known_robots.radius
        self._sent_rates = self._sent_rates.with_room()
        note(self._sent_rates, now_ns + self._lead_ns, np.zeros((2, radius.size)), radius)

    def transmit(
        self, now_ns: int, action: Steer | Turn | FieldOff, is_new: bool, frame: Observation
    ) -> tuple[Floats, Floats]:
        """Compute the wheel speeds for an action, and schedule the next transmission.

        Args:
            now_ns: The present time [ns].
            action: The action to transmit.
            is_new: Whether the action has not been transmitted before.
            frame: The newest frame received.

        Returns:
            Speeds of left and right wheels, (2, N) each [length unit/s]: first as the host knows
            them from calibrated gains and dead zones, then as the wheels really run.
        """
        if self._section.rate is not None:  # as the lab's inner loop does
            due_ns = 0 if self.next_repeat_ns == NEVER_NS else self.next_repeat_ns
            self.next_repeat_ns = next_due_ns(due_ns, now_ns, round(SECOND / self._section.rate))
        if is_new or self._section.recompute:
            self._update_speeds(now_ns + self._lead_ns, action, frame)
        return self._last_speeds

    def _update_speeds(
        self, acts_ns: int, action: Steer | Turn | FieldOff, frame: Observation
    ) -> None:
        """Compute new wheel speeds, which take effect at `acts_ns` [ns]."""
        measured_ns = frame.sampled_ns
        if (
            self._section.lead is None
        ):  # the measured headings are used as the headings at that time
            measured_ns = acts_ns
        headings = frame.poses.heading.copy()  # a read-only array is another type to the kernel
        self._sent_rates = self._sent_rates.with_room()
        if isinstance(action, Steer) and action.lag_s is not None:
            self._known_robots = self._known_robots._replace(lag_s=action.lag_s)
        self._last_speeds = self._compute_speeds(
            headings=headings,
            directions=find_aimed_directions(action, headings),
            measured_ns=measured_ns,
            acts_ns=acts_ns,
            robots=self._known_robots.turning() if isinstance(action, Turn) else self._known_robots,
            sent_rates=self._sent_rates,
            wheels=self.drivetrains,
        )


def sample_drivetrains(
    section: WheelDriveSection, n_robots: int, random: np.random.Generator
) -> "WheelArrays":
    """Sample the true gains and dead zones of the wheels for one trial.

    The result has no rounding errors to carry over yet.

    Args:
        section: The section of the wheels.
        n_robots: Number of robots.
        random: The random generator.
    """
    from tetractl.plant.drive_kernels import WheelArrays

    shape = (2, n_robots)
    gain = 1.0 if section.count is None else section.count
    # in this order: it is part of the result
    gain_factors = 1 + section.gain_error * random.uniform(-1, 1, shape)
    dead_zone_error = section.dead_zone_error
    dead_zones = section.dead_zone + random.integers(-dead_zone_error, dead_zone_error + 1, shape)
    return WheelArrays(
        rounding_errors=np.zeros(shape),
        gain=np.full(shape, float(gain)),
        dead_zone=np.full(shape, float(section.dead_zone)),
        true_gain=gain * gain_factors,
        true_dead_zone=np.maximum(dead_zones, 0.0),
        limit=np.full(n_robots, 0.0 if section.count is None else float(COUNT_MAX)),
    )
