"""The `field` actuator: steers all cells by the direction of a common magnetic field.

A cell turns towards the field's direction u by equation (3) of the paper, at a rate proportional to
the field's strength B. The spec's turning rate a holds at the spec's `strength` B0, or the
actuator's `strength_mt`, so the heading changes at the rate a (B / B0) sin(u - heading).
"""

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Self

import numpy as np

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.commands import Action, Steer, Stop, Transmission, Turn
from tetractl.core.errors import AbortError
from tetractl.core.poses import Floats, Pose
from tetractl.core.protocols import Health, RobotStatus
from tetractl.core.setup import Setup
from tetractl.lab.cobs import Flag
from tetractl.lab.serial_port import PortFactory
from tetractl.model.motion.exact import rates
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS
from tetractl_microscope.coils.driver import (
    HINT,
    REPLY_MAX_S,
    UNKNOWN_TEMPERATURE,
    VERSION,
    Driver,
    DriverStatus,
    FieldReply,
)
from tetractl_microscope.coils.section import FieldSection, Pair, step_towards

NO_CURRENT: Pair = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class RequestedCurrents:
    """Coil currents that were requested from the driver.

    Attributes:
        currents: The currents in the x and y coils [A].
        sent_ns: When they were requested [ns].
        held_until_ns: Until when the driver holds them [ns]. They then fall to 0.
    """

    currents: Pair
    sent_ns: int
    held_until_ns: int


class FieldActuator:
    """An actuator that turns N cells with a common magnetic field; see `Actuator`.

    No cell can be stopped: every transmission, even a stop, reports that all cells move at their
    own speed. The `outputs` of a transmission are the currents requested from the driver,
    `current_x_a` and `current_y_a` [A], and the resulting field, `field_mt` [mT] and
    `field_direction_rad` [rad].

    Args:
        section: The actuator's section of the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        ports: Creates the driver's serial port. None for `SerialPort`.
    """

    halts = False

    def __init__(
        self, section: FieldSection, setup: Setup, clock: Clock, ports: PortFactory | None = None
    ) -> None:
        self.section = section
        self.coils = section.coils
        self.driver = Driver(section.port, section.baud, clock, ports)
        self._a = setup.a
        self._speed = setup.speed
        self._clock = clock
        self._reference_mt = section.reference_mt(setup)
        self._lock = threading.Lock()
        previous_ns = clock.now() - self.period_ns
        self._requested = RequestedCurrents(NO_CURRENT, previous_ns, previous_ns)

    def __enter__(self) -> Self:
        try:
            self.driver.open()
        except BaseException:
            self.driver.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(AbortError):
            self.stop()
        self.driver.close()

    def settle(self, setup: Setup) -> None:
        """Use the turning rates and speeds of a new setup, after a trial has chosen its cells.

        The field stays as it is.
        """
        self._a = setup.a
        self._speed = setup.speed

    @property
    def period_ns(self) -> int:
        """Time between two commands while the direction stays the same [ns]."""
        return round(SECOND / self.section.rate)

    @property
    def failure(self) -> str | None:
        """The reason why the driver no longer makes a field. None if it does."""
        return self.driver.failure

    def send(
        self,
        action: Steer | Turn,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        """Turn the field to a direction, as far as the slew limit allows; see `Actuator.send`.

        The currents (x, y) change along a straight line, so the strength of a field that turns by
        half a circle passes through 0.
        """
        if isinstance(action, Turn):
            raise AbortError("cells cannot turn on the spot: they swim all the time")
        failure = self.failure
        if failure is not None:
            raise AbortError(failure, HINT)
        with self._lock:
            now_ns = self._clock.now()
            section = self.section
            target = self.coils.currents(
                action.direction, self._reference_mt, section.current_max_a
            )
            elapsed_ns = min(now_ns - self._requested.sent_ns, self.period_ns)
            currents = step_towards(
                self._present_currents(now_ns), target, self._max_change(elapsed_ns)
            )
            x_ma, y_ma = (round(1000 * current) for current in currents)
            sent_ns = self.driver.send(Flag.RUN, x_ma, y_ma)
            held_until_ns = sent_ns + round(section.watchdog * SECOND)
            self._requested = RequestedCurrents(currents, sent_ns, held_until_ns)
        headings = np.array([np.nan if pose is None else pose.heading for pose in poses])
        return self._transmission(action, sent_ns, (x_ma / 1000, y_ma / 1000), headings)

    def stop(self, emergency: bool = False) -> Transmission:
        """Switch the field off. Both currents fall to 0 at the slew limit, and the cells swim on.

        Three frames are sent, so that a damaged frame does not lose the stop.

        Args:
            emergency: Whether the driver must make no field until it is power-cycled.

        Raises:
            AbortError: If the port has failed.
        """
        with self._lock:
            currents = self._present_currents(self._clock.now())
            flag = Flag.EMERGENCY_STOP if emergency else Flag(0)
            # three frames, so that one damaged frame does not lose the stop
            sent_ns = [self.driver.send(flag) for _ in range(3)][-1]
            self._requested = RequestedCurrents(currents, sent_ns, held_until_ns=sent_ns)
        no_turning = np.full(len(self._a), np.nan)
        return self._transmission(Stop(), sent_ns, NO_CURRENT, no_turning)

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Return one status per cell at once, with `answers` None, because cells cannot be polled.

        `timeout_s` is not used.
        """
        return [RobotStatus(answers=None)] * len(self._a)

    def check(self) -> Health:
        """Switch the field off, and check the driver; see `inspect_reply`.

        If the driver's port has failed, this is the only problem.
        """
        try:
            reply = self.driver.ask()
        except AbortError as error:
            return Health(problems=(error.message,))
        return inspect_reply(reply, self.section, self._reference_mt)

    def _max_change(self, passed_ns: int) -> float:
        """Return the maximum change of a current [A] within a time [ns]."""
        return self.section.slew_max_a_s * passed_ns / SECOND

    def _present_currents(self, now_ns: int) -> Pair:
        """Compute the driver's set points [A] at a time [ns]. Without commands, they fall to 0."""
        falling_ns = max(0, now_ns - self._requested.held_until_ns)
        return step_towards(self._requested.currents, NO_CURRENT, self._max_change(falling_ns))

    def _transmission(
        self, action: Action, sent_ns: int, currents: Pair, headings: Floats
    ) -> Transmission:
        """Describe a transmission: the field of the currents [A], and how it turns each cell.

        Headings are in radians. The turning rates grow with the field's strength, and are
        0 for a cell whose heading is NaN.
        """
        x_mt, y_mt = self.coils.field(currents)
        strength_mt = float(np.hypot(x_mt, y_mt))
        direction = float(np.arctan2(y_mt, x_mt))
        a = self._a * (strength_mt / self._reference_mt)
        turning_rates = rates(headings, direction, a, self._speed)[2]
        return Transmission(
            action,
            sent_ns,
            (True,) * len(self._a),
            speed=self._speed.copy(),
            turning=np.nan_to_num(turning_rates),
            outputs={
                "current_x_a": currents[0],
                "current_y_a": currents[1],
                "field_mt": strength_mt,
                "field_direction_rad": direction,
            },
        )


def inspect_reply(reply: FieldReply | None, section: FieldSection, needed_mt: float) -> Health:
    """Check the reply of the current driver before a run.

    Args:
        reply: The reply. None if the driver does not reply.
        section: The actuator's section of the spec.
        needed_mt: The field strength that is needed [mT].

    Returns:
        Problems that prevent a run, warnings, and facts about the driver for the log.
    """
    if reply is None:
        port_text = f"{section.port} at {section.baud} baud"
        return Health((f"no current driver answers on {port_text}: is the driver switched on?",))
    if reply.version != VERSION:
        problem = (
            f"the current driver uses protocol version {reply.version}, but tetractl needs "
            f"version {VERSION}"
        )
        return Health((problem,))
    current_max_a = reply.current_max_ma / 1000
    slew_max_a_s = reply.slew_ma_s / 1000
    supply_v = reply.supply_mv / 1000
    temperature_c = reply.temperature_dc / 10
    has_temperature = reply.temperature_dc != UNKNOWN_TEMPERATURE
    limit_ma = round(1000 * section.current_max_a)
    reachable_mt = section.coils.least_reach(section.current_max_a)
    facts = {
        "field_driver_version": str(reply.version),
        "field_driver_current_max_a": f"{current_max_a:g}",
        "field_driver_slew_a_s": f"{slew_max_a_s:g}",
        "field_driver_watchdog_s": f"{reply.watchdog_ms / 1000:g}",
        "field_driver_frames_rejected": str(reply.rejected),
    }
    if supply_v:
        facts["field_driver_supply_v"] = f"{supply_v:g}"
    if has_temperature:
        facts["field_driver_temperature_c"] = f"{temperature_c:g}"
    problems = {
        (
            f"the current driver allows only {current_max_a:g} A, but the spec allows "
            f"{section.current_max_a:g} A: lower current_max_a in the spec"
        ): reply.current_max_ma < limit_ma,
        (
            f"the current driver allows only {slew_max_a_s:g} A/s, but the spec allows "
            f"{section.slew_max_a_s:g} A/s: lower slew_max_a_s in the spec"
        ): reply.slew_ma_s < round(1000 * section.slew_max_a_s),
        (
            f"the current driver's watchdog is {reply.watchdog_ms / 1000:g} s, but the spec's is "
            f"{section.watchdog:g} s: change one of them"
        ): reply.watchdog_ms != round(1000 * section.watchdog),
        "the current driver has stopped because the coils were too hot: let them cool down": (
            DriverStatus.HOT in reply.status
        ),
        "the current driver is emergency-stopped: switch it off and on again": (
            DriverStatus.EMERGENCY_STOPPED in reply.status
        ),
        (
            f"the supply voltage of the current driver is {supply_v:.2f} V, but supply_min_v in "
            f"the spec is {section.supply_min_v:g} V"
        ): 0 < supply_v < section.supply_min_v,
        f"the coils are at {temperature_c:.0f} °C: let them cool down": has_temperature
        and temperature_c >= 60,
    }
    warnings = {
        (
            f"the spec needs a field of {needed_mt:g} mT, but in some directions the coils reach "
            f"only {reachable_mt:.3g} mT: cells will turn more slowly there"
        ): reachable_mt < needed_mt,
        (
            f"the current driver itself allows {current_max_a:g} A: if tetractl fails, nothing "
            f"limits the current to the {section.current_max_a:g} A of the spec"
        ): reply.current_max_ma > limit_ma,
        "the current driver does not report its supply voltage": section.supply_min_v
        > supply_v
        == 0,
    }
    return Health(_select_true_messages(problems), _select_true_messages(warnings), facts)


def stop_all(section: FieldSection, setup: Setup, clock: Clock, alone: bool) -> str:
    """Switch the field off until the driver is power-cycled; see `ActuatorSection.stop_all`.

    Ten stops are sent within 200 ms. If `alone` is False, another process may have the port open
    and take the replies, so no reply is expected.

    Raises:
        AbortError: If the driver does not reply that it is stopped.
    """
    actuator = FieldActuator(section, setup, clock)
    driver = actuator.driver
    try:
        driver.open(alone)
        for _ in range(STOP_COUNT):
            actuator.stop(emergency=True)
            clock.sleep_until(clock.now() + STOP_GAP_NS)
        if alone and not wait_for(clock, lambda: driver.is_emergency_stopped, REPLY_MAX_S):
            raise AbortError(
                f"sent {STOP_COUNT} stops, but no current driver on {section.port} at "
                f"{section.baud} baud has confirmed that it stopped",
                "switch off the power supply of the current driver",
            )
    finally:
        driver.close()
    return f"sent {STOP_COUNT} stops"


def _select_true_messages(condition_by_message: dict[str, bool]) -> tuple[str, ...]:
    """Return the messages whose condition holds, in the order of `condition_by_message`."""
    return tuple(message for message, is_true in condition_by_message.items() if is_true)
