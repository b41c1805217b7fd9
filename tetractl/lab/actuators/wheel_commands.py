"""The common part of actuators for robots on two wheels.

It computes the wheel speeds for a direction, and polls robots for their state.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Protocol, Self

import numpy as np

from tetractl.core.clock import MILLISECOND, SECOND, Clock
from tetractl.core.commands import Action, Steer, Stop, Transmission, Turn
from tetractl.core.poses import Bools, Floats, Pose
from tetractl.core.protocols import Health, RobotStatus
from tetractl.core.setup import MILLIMETRE_M, Setup
from tetractl.model.wheels import CountArray, Drivetrains, WheelHost

PREDICTION_MAX_NS = SECOND // 10
"""Maximum time over which headings are predicted [ns]."""
POLLS_MAX = 5
"""Maximum number of polls until a robot counts as silent. Single polls and replies may be lost."""
BATTERY_EMPTY_V = 4.0
"""Voltage of four battery cells below which the motors would soon fail [V]."""


class Status(IntFlag):
    """Status flags in a robot's reply: driving, emergency-stopped, or stopped by its watchdog."""

    RUNNING = 1  # the last frame set the run flag
    EMERGENCY_STOPPED = 2
    SILENT = 4  # stopped by the watchdog


@dataclass(frozen=True, slots=True)
class Reply:
    """A robot's reply to a poll, with its state and battery voltage.

    Attributes:
        id: Index of the robot in commands.
        sequence: Sequence number of the command that polled the robot.
        status: The robot's status.
        battery_mv: Voltage of the robot's battery [mV]. 0 if unknown.
        received: Number of frames that the robot received with a right CRC, modulo 65536.
        rejected: Number of frames that the robot received with a wrong CRC, modulo 65536.
    """

    id: int
    sequence: int
    status: Status
    battery_mv: int
    received: int
    rejected: int


class PolledLink(Protocol):
    """A connection over which robots are polled for their state."""

    @property
    def failure(self) -> str | None:
        """The reason why nothing can be sent any more. None while sending works."""
        ...

    def send_poll(self) -> tuple[int, int]:
        """Send a poll to all robots, and drop replies that have arrived before.

        Returns:
            The sequence number of the poll, and the time of sending [ns].
        """
        ...

    def receive_replies(self, timeout_s: float) -> Iterable[Reply]:
        """Return the replies received so far. If there are none, wait until a reply arrives.

        Args:
            timeout_s: Maximum time to wait [s]. The result is empty if no reply arrives.
        """
        ...


def poll_robots(
    link: PolledLink, indices: Sequence[int], clock: Clock, timeout_s: float, slot_ms: int
) -> list[Reply | None]:
    """Poll robots until each of them has replied, at most POLLS_MAX times.

    Robot i replies to a poll i slots later. A reply counts only if its sequence number belongs to
    one of these polls. A reply to an earlier command, or a reply from a device that did not receive
    this poll, says nothing about the present state. Time during which the computer slept counts as
    one poll. The function returns at once if the link has failed.

    Args:
        link: The connection to the robots.
        indices: The robots' indices.
        clock: The clock for timeouts.
        timeout_s: How long to wait in total [s].
        slot_ms: Duration of a slot [ms].

    Returns:
        The reply of each robot. None if it did not reply.
    """
    reply_by_index = dict[int, Reply]()
    awaited_indices = set(indices)
    sequences = set[int]()
    wait_ns = (max(indices) + 2) * slot_ms * MILLISECOND + SECOND // 10
    polls_in_time = round(timeout_s * SECOND) // wait_ns
    for _ in range(max(1, min(POLLS_MAX, polls_in_time))):
        sequence, sent_ns = link.send_poll()
        sequences.add(sequence)
        deadline_ns = sent_ns + wait_ns
        while not awaited_indices <= reply_by_index.keys():
            remaining_ns = deadline_ns - clock.now()
            if remaining_ns <= 0:
                break
            for reply in link.receive_replies(remaining_ns / SECOND):
                if reply.sequence in sequences:
                    reply_by_index[reply.id] = reply
            if link.failure is not None:
                break
        if link.failure is not None or awaited_indices <= reply_by_index.keys():
            break
    return [reply_by_index.get(index) for index in indices]


def radii_mm(setup: Setup, stated_mm: Sequence[float | None]) -> Floats:
    """Return the distance from each robot's wheels to its centre [mm], shape (N,).

    Args:
        setup: The constants of the experiment, with the distance for all robots.
        stated_mm: The distance that the spec states for each robot [mm], N entries. None for a
            robot without such a value.

    Returns:
        The distances. NaN for a robot without a distance of its own, if the setup has none either.
    """
    radius = (
        math.nan if setup.wheel_radius is None else setup.wheel_radius * setup.metres / MILLIMETRE_M
    )
    return np.array([radius if stated is None else stated for stated in stated_mm])


def wheels_by_speed(gain: Floats, speed_max: float) -> Drivetrains:
    """Create the wheels of robots that are commanded by speeds instead of motor counts.

    Args:
        gain: True speed per unit that is sent [mm/s], shape (2, N): left and right wheels.
        speed_max: Maximum speed that is sent, in the unit that is sent.
    """
    n_robots = gain.shape[1]
    return Drivetrains(
        gain=gain,
        dead_zone=np.zeros((2, n_robots), dtype=np.int64),
        limit=np.full(n_robots, int(speed_max), dtype=np.int64),
        swap=np.zeros(n_robots, dtype=np.bool_),
    )


class RobotLink(Protocol):
    """The connection between this computer and the robots, by radio, cable or network."""

    @property
    def failure(self) -> str | None:
        """The reason why nothing can be sent any more. None while sending works."""
        ...

    def open(self) -> None:
        """Open the ports of the connection."""
        ...

    def close(self) -> None:
        """Release the ports of the connection."""
        ...


class WheeledActuator(ABC):
    """The base class of actuators for robots on two wheels; see `tetractl.core.protocols.Actuator`.

    Args:
        setup: The constants of the experiment.
        clock: The clock for times.
        link: The connection to the robots.
        stated_radii_mm: Distance of each robot's wheels from its centre [mm], N entries. None for
            the spec's distance.
        drivetrains: The robots' wheels and motors.
        delay_ns: Time from sending a command to its arrival [ns].
        rate: Commands sent per second [Hz].
        ask: Polls the robots within a time [s]. None if they cannot answer.
        warn_v: Battery voltage below which the operator is warned [V].
    """

    halts = True
    held_outputs: CountArray | None = None
    """Wheel outputs that are sent instead of those for the action, during a calibration, (2, N).

    None to send the outputs for the action.
    """

    def __init__(
        self,
        setup: Setup,
        clock: Clock,
        link: RobotLink,
        stated_radii_mm: Sequence[float | None],
        drivetrains: Drivetrains,
        delay_ns: int,
        rate: float,
        ask: Callable[[float], Sequence[Reply | None]] | None = None,
        warn_v: float = 0.0,
    ) -> None:
        self.names = setup.names
        self.radii = radii_mm(setup, stated_radii_mm)
        self.period_ns = round(SECOND / rate)
        self._clock = clock
        self._link = link
        self._delay_ns = delay_ns
        self._mm = setup.metres / MILLIMETRE_M  # millimetres per length unit of the spec
        speed = setup.speed * self._mm
        self._host = WheelHost(setup.a, speed, self.radii, setup.lag_s, drivetrains)
        self._ask = ask
        self._warn_v = warn_v

    def __enter__(self) -> Self:
        """Open the connection to the robots."""
        try:
            self._link.open()
        except BaseException:
            self._link.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()

    @property
    def failure(self) -> str | None:
        """Why nothing can be sent any more. None if there is no fault."""
        return self._link.failure

    def send(
        self,
        action: Steer | Turn,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        """Send each robot the wheel speeds for an action; see `Actuator.send`.

        If `held_outputs` is set, these outputs are sent instead. Robots that may not move get 0.

        Args:
            action: The direction to drive in, or to turn to on the spot.
            poses: Pose of each robot, N entries. None if it is untracked.
            moving: Whether each robot may move, N entries.
            exposed_ns: The time of the poses [ns].
        """
        may_move = np.array(moving, dtype=np.bool_)
        if self.held_outputs is None:
            outputs = self.outputs(self.compute_wheel_speeds(action, poses, exposed_ns), may_move)
        else:
            outputs = self.held_outputs * may_move
        sent_ns, speeds = self._drive(outputs)
        return self._transmission(sent_ns, action, speeds, tuple(moving))

    def stop(self, emergency: bool = False) -> Transmission:
        """Send one stop to every robot, and return the transmission.

        Args:
            emergency: Whether robots latch the stop, if they can: they then stay stopped until they
                are switched off.
        """
        sent_ns = self._halt(emergency)
        n_robots = len(self.names)
        zero_outputs = np.zeros((2, n_robots), dtype=np.int64)
        zero_speeds = self._host.drivetrains.speeds(zero_outputs)
        return self._transmission(sent_ns, Stop(), zero_speeds, (True,) * n_robots)

    def outputs(self, wheel_speeds: Floats, may_move: Bools) -> CountArray:
        """Convert wheel speeds to the outputs that are sent, in the actuator's own unit.

        Args:
            wheel_speeds: Wheel speeds, left and right, shape (2, N) [mm/s].
            may_move: Whether each robot may move, shape (N,).

        Returns:
            The outputs, shape (2, N). 0 for robots that may not move.
        """
        return self._host.counts(wheel_speeds) * may_move

    def compute_wheel_speeds(
        self, action: Steer | Turn, poses: Sequence[Pose | None], exposed_ns: int
    ) -> Floats:
        """Compute the wheel speeds (2, N) [mm/s] that an action requires, with `WheelHost`.

        Headings are predicted to the time when the command reaches the wheels, over at most
        PREDICTION_MAX_NS. Robots without a pose stand still.

        Args:
            action: The action.
            poses: Pose of each robot. None if it is untracked.
            exposed_ns: The time of the poses [ns].
        """
        arrival_ns = self._clock.now() + self._delay_ns
        since_ns = max(exposed_ns, arrival_ns - PREDICTION_MAX_NS)
        heading = np.array([0.0 if pose is None else pose.heading for pose in poses])
        is_driving = isinstance(action, Steer)
        if is_driving and action.lag_s is not None:
            self._host.assume_lag(action.lag_s)
        direction = action.direction if is_driving else action.facing
        wheel_speeds = self._host.compute_speeds(
            heading, direction, since_ns, arrival_ns, is_driving
        )
        wheel_speeds[:, [pose is None for pose in poses]] = 0.0
        return wheel_speeds

    @abstractmethod
    def _drive(self, outputs: CountArray) -> tuple[int, Floats]:
        """Send the robots their wheel outputs (2, N), in the actuator's own unit.

        Returns:
            When they were sent [ns], and the wheel speeds (2, N) that they request [mm/s].
        """

    @abstractmethod
    def _halt(self, emergency: bool) -> int:
        """Send a stop to every robot, and return when it was sent [ns].

        If `emergency` is true, the robots latch the stop, if they can.
        """

    def check(self) -> Health:
        """Return an empty report: by default, an actuator has nothing to report."""
        return Health()

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Ask every robot for its battery voltage and state, for at most `timeout_s` seconds.

        Returns:
            The status of each robot. Its `answers` is None if the robots cannot answer.
        """
        if self._ask is None:
            return [RobotStatus(answers=None) for _ in self.names]
        replies = zip(self.names, self._ask(timeout_s), strict=True)
        return [robot_status(name, reply, self._warn_v) for name, reply in replies]

    def _transmission(
        self, sent_ns: int, action: Action, speeds: Floats, delivered: tuple[bool, ...]
    ) -> Transmission:
        """Create the record of a transmission from the wheel speeds (2, N) [mm/s].

        Robots are assumed to have received it, because broadcasts are not acknowledged.
        """
        speed, turning = self._host.record_sent(sent_ns + self._delay_ns, speeds)
        left_speed, right_speed = speeds / self._mm
        return Transmission(
            action,
            sent_ns,
            delivered,
            left_speed,
            right_speed,
            speed=speed / self._mm,
            turning=turning,
        )


def robot_status(name: str, reply: Reply | None, warn_v: float) -> RobotStatus:
    """Describe a robot's reply to a poll for the operator.

    Args:
        name: The robot.
        reply: Its reply. None if it did not reply.
        warn_v: Voltage below which its battery is low [V].
    """
    if reply is None:
        problem = f"{name} does not answer: is the robot switched on, and is its index right?"
        return RobotStatus(False, problems=(problem,))
    battery_v = reply.battery_mv / 1000 or None
    battery_text = "" if battery_v is None else f"{name}'s battery has {battery_v:.2f} V"
    if reply.status & Status.EMERGENCY_STOPPED:
        problem = f"{name} is emergency-stopped: switch it off and on again"
        return RobotStatus(True, battery_v, (problem,))
    if battery_v is not None and battery_v < BATTERY_EMPTY_V:
        return RobotStatus(True, battery_v, (f"{battery_text}: charge it",))
    return RobotStatus(
        True, battery_v, (), (battery_text,) if battery_v is not None and battery_v < warn_v else ()
    )
