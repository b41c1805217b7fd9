"""The host of simulated robots on wheels: what it sends, and how fast wheels then turn in truth."""

import numpy as np

from tetractl.core.clock import NEVER, SECOND, next_due_ns
from tetractl.core.commands import FieldOff, Steer, Turn
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.model.motion.rolling import note
from tetractl.model.wheels import COUNT_MAX, SentRates
from tetractl.plant.direct import aim
from tetractl.plant.sim_section import WheelDriveSection


class SimHost:
    """Computes the wheel speeds of N robots by equations (24)-(25) at the headings of the newest
    frame, rounds them to wheel counts, and says when it transmits next.

    `random` draws the true gains, then the true dead zones.
    """

    def __init__(
        self, section: WheelDriveSection, setup: Setup, random: np.random.Generator
    ) -> None:
        from tetractl.plant.wheel_kernel import GAIN, TRUE_GAIN, answer  # late: compiled

        assert setup.wheel_radius is not None, "the wheels need a radius"
        robots = setup.a.size
        self._answer = answer
        self._section = section
        self._known = np.array([setup.a, setup.speed, np.full(robots, setup.wheel_radius)])
        self._lag_s = 0.0 if section.lead is None else setup.lag_s
        self._lead_ns = round((section.lead or 0.0) * SECOND)
        self._sent = SentRates.none(robots)
        self._speeds = np.zeros((2, 2, robots))
        """The wheel speeds of the last transmission, as `transmit` returns them."""
        self.trains = true_trains(section, robots, random)
        """Wheels as calibrated and in truth, (TRAIN_ROWS, 2, N) of `wheel_kernel`."""
        self.gains = np.mean(self.trains[TRUE_GAIN] / self.trains[GAIN], axis=0)
        """By how much robots drive and turn faster than sent, (N,); where the two wheels differ,
        the robot turns on its way, too: its heading bias."""
        self.repeats_ns = NEVER
        """The time of the next transmission of the same action [ns]."""

    def halt(self, now_ns: int) -> None:
        """Transmit nothing more from now on, because a stop is sent."""
        self.repeats_ns = NEVER
        still = np.zeros((2, self._known.shape[1]))
        self._sent = self._sent.with_room()
        note(now_ns + self._lead_ns, still, self._known, self._sent.times_ns, self._sent.rates)

    def transmit(
        self, now_ns: int, action: Steer | Turn | FieldOff, is_new: bool, frame: Observation
    ) -> Floats:
        """Return the wheel speeds sent `now_ns` for an action, and schedule the next transmission.

        They have the shape (2, 2, N) [length unit/s]: as the host knows them, by calibrated gains
        and dead zones, and as the wheels run in truth; of each, left and right ones. `frame` is the
        newest one received; `is_new` if the action has not been transmitted before.
        """
        if self._section.rate is not None:  # as the lab's inner loop does
            due_ns = 0 if self.repeats_ns == NEVER else self.repeats_ns
            self.repeats_ns = next_due_ns(due_ns, now_ns, round(SECOND / self._section.rate))
        if not is_new and not self._section.recompute:
            return self._speeds
        acts_ns = now_ns + self._lead_ns
        # without a lead, the measured headings are taken as those at which the speeds act
        since_ns = acts_ns if self._section.lead is None else frame.sampled_ns
        headings = frame.poses.heading
        self._speeds = np.empty((2, *self.trains.shape[1:]))
        self._sent = self._sent.with_room()
        self._answer(
            headings.copy(),
            aim(action, headings).copy(),
            not isinstance(action, Turn),
            since_ns,
            acts_ns,
            self._known,
            self._lag_s,
            self._sent.times_ns,
            self._sent.rates,
            self.trains,
            self._speeds,
        )
        return self._speeds


def true_trains(section: WheelDriveSection, robots: int, random: np.random.Generator) -> Floats:
    """Return the wheels (TRAIN_ROWS, 2, N) of one trial; nothing is owed yet."""
    from tetractl.plant import wheel_kernel as rows

    wheels = (2, robots)
    gain = 1.0 if section.count is None else section.count
    # in this order: it is part of the result
    gain_factors = 1 + section.gain_error * random.uniform(-1, 1, wheels)
    zone_error = section.dead_zone_error
    dead_zones = section.dead_zone + random.integers(-zone_error, zone_error + 1, wheels)
    trains = np.zeros((rows.TRAIN_ROWS, *wheels))
    trains[rows.GAIN] = gain
    trains[rows.DEAD_ZONE] = section.dead_zone
    trains[rows.TRUE_GAIN] = gain * gain_factors
    trains[rows.TRUE_DEAD_ZONE] = np.maximum(dead_zones, 0)
    if section.count is not None:
        trains[rows.COUNT_LIMIT] = COUNT_MAX
    return trains
