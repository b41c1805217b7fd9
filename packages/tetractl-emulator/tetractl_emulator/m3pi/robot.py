"""Emulated robots with two wheels: their programs, and how they move.

An `EmulatedRobot` is the electronics of one robot. By default, it runs the compiled core of the
real firmware, which reads bytes from the radio and sets the counts of both motors.

`EmulatedRobots` moves all robots. Each wheel follows the speed of its counts with a first-order
lag. A robot with wheel speeds l and r, whose wheels are at the distance d from its centre, drives
at (l + r) / 2 and turns at (r - l) / (2 d); see `model.wheels`. Lengths are in mm and speeds in
mm/s. Times are in ms in a program, and in ns elsewhere.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.poses import Floats, Poses
from tetractl.lab.actuators.wheel_commands import Status
from tetractl.model.wheels import Counts, Drivetrains, WheeledRobots
from tetractl.plant.drive_kernels import roll
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.firmware import RobotCore

STANDSTILL_MM_S = 1.0
"""Wheel speed below which a robot counts as standing still [mm/s]. No camera detects less."""
AT_REST_MM_S = 1e-9
"""Wheel speed below which the simulation stops a wheel [mm/s]."""
FULL_LOAD_MM_S = 2000.0
"""Sum of the speeds of both wheels at the battery's full load [mm/s]."""
ON_BEFORE_START_MS = 10_000
"""Time for which robots have been switched on when an emulation begins [ms]."""
BATTERY_MV = 5100
"""Voltage of a robot's four NiMH cells without load [mV]."""
SAG_MV = 150.0
"""Drop of the battery's voltage at full load [mV]."""
Speeds = tuple[float, float]
"""The speeds of a robot's left and right wheel [mm/s]."""
MotorDrive = tuple[Counts, tuple[float, float]]
"""The counts of a robot's motors, and the fraction of its speed at which each wheel turns."""


class Program(Protocol):
    """The program of a robot's microcontroller, such as a `WheelsCore`. Times are in ms."""

    def push(self, data: bytes, now_ms: int) -> Any:
        """Process bytes that the robot has received by radio."""
        ...

    def wheels(self, now_ms: int) -> Counts:
        """Return the present counts of the left and the right motor.

        They are 0 after the watchdog has expired.
        """
        ...

    def status(self, now_ms: int) -> Status:
        """Return the status flags: running, emergency-stopped, or without a recent command."""
        ...

    def take_reply(self, now_ms: int) -> bytes:
        """Return the bytes to send now, or b"" if there are none. Each reply is returned once."""
        ...

    def set_battery(self, battery_mv: int) -> None:
        """Set the battery voltage that the program measures [mV]."""
        ...


class EmulatedRobot:
    """The electronics of one robot. `EmulatedRobots` moves the robot.

    Args:
        name: Name of the robot.
        index: Number of the robot in broadcasts, which is built into its firmware.
        battery_mv: Voltage of its battery without load [mV].
        make_core: Creates the robot's program, given its index.
        acting: The faults that act now. The robot looks up those that name it. None if there are
            none.
    """

    robots: "EmulatedRobots"
    row: int

    def __init__(
        self,
        name: str,
        index: int,
        battery_mv: int = BATTERY_MV,
        make_core: Callable[[int], Program] = RobotCore,
        acting: ActingFaults | None = None,
    ) -> None:
        self.name = name
        self.index = index
        self._make_core = make_core
        self._switched_on_ms = 0  # time from which its program counts
        self.core = self._make_running_core()
        self._unloaded_mv = battery_mv
        self.powered = True
        self.acting = acting or ActingFaults()

    @property
    def x(self) -> float:
        """True position x of the robot in the spec's axes [mm]."""
        return float(self.robots.pose[0, self.row])

    @property
    def y(self) -> float:
        """True position y of the robot in the spec's axes [mm]."""
        return float(self.robots.pose[1, self.row])

    @property
    def heading(self) -> float:
        """True heading of the robot in the spec's axes [rad]."""
        return float(self.robots.pose[2, self.row])

    @property
    def wheels(self) -> Speeds:
        """The true speeds of the left and the right wheel [mm/s]."""
        left, right = self.robots.wheels
        return float(left[self.row]), float(right[self.row])

    @property
    def standing(self) -> bool:
        """Whether both wheels stand still, or turn more slowly than STANDSTILL_MM_S.

        A camera could not detect such a slow motion.
        """
        return max(map(abs, self.wheels)) < STANDSTILL_MM_S

    def receive(self, data: bytes) -> None:
        """Process bytes from the robot's radio module, unless the robot is switched off."""
        if self.powered:
            self.core.set_battery(self._battery_mv())
            self.core.push(data, self._now_ms)

    def _battery_mv(self) -> int:
        """Return the battery's voltage at the present load [mV].

        During the fault `low_battery`, it is the voltage of the fault.
        """
        fault = self.acting.newest("low_battery", self.name)
        if fault is not None:
            return fault.millivolts
        load = min(1.0, sum(map(abs, self.wheels)) / FULL_LOAD_MM_S)
        return max(0, round(self._unloaded_mv - SAG_MV * load))

    @property
    def late_ns(self) -> int:
        """The additional delay with which the robot executes what it receives [ns].

        It is 0 unless the fault `reboots` acts.
        """
        return round(self.acting.total_by("reboots", self.name) * SECOND)

    def answer(self) -> bytes:
        """Return the bytes that the robot sends now.

        The result is b"" if the robot has nothing to send, or if it is switched off.
        """
        return self.core.take_reply(self._now_ms) if self.powered else b""

    @property
    def status(self) -> Status:
        """The status flags of the robot's program now, even if the robot is switched off."""
        return self.core.status(self._now_ms)

    def counts(self) -> Counts:
        """Return the present counts of the left and the right motor, which faults may change.

        The counts are 0 if the robot is switched off.
        """
        if not self.powered:
            return 0, 0
        counts = self.core.wheels(self._now_ms)
        veer = self.acting.newest("veer", self.name) if any(counts) else None
        return counts if veer is None else veer.counts

    def speed_fraction(self, wheel: str) -> float:
        """Return the fraction of the commanded speed at which a wheel turns: 1 unless a fault acts.

        Args:
            wheel: "left" or "right".
        """
        if not self.acting.has_had_any:  # saves time
            return 1.0
        if any(
            fault.wheel in (wheel, "both")
            for fault in self.acting.of_kind("wheel_stuck", self.name)
        ):
            return 0.0
        faults = self.acting.of_kind("weak_wheel", self.name)
        return min((fault.share for fault in faults if fault.wheel in (wheel, "both")), default=1.0)

    def switch(self, on: bool) -> None:
        """Switch the robot on or off.

        Switching it on restarts its program, even if it was on before.
        """
        self.powered = on
        if on:
            self._switched_on_ms = self.robots.now_ms
            self.core = self._make_core(self.index)

    def renumber(self, index: int) -> None:
        """Replace the robot's firmware with one that was built for another index.

        The new program has already run for ON_BEFORE_START_MS.
        """
        self.index = index
        self.core = self._make_running_core()

    def _make_running_core(self) -> Program:
        """Create a program with the robot's index that has already run for ON_BEFORE_START_MS."""
        core = self._make_core(self.index)
        core.wheels(ON_BEFORE_START_MS)
        return core

    @property
    def _now_ms(self) -> int:
        """The time since the robot was switched on [ms]."""
        return self.robots.now_ms - self._switched_on_ms

    def place(self, x: float, y: float, heading: float) -> None:
        """Put the robot at a pose, at standstill.

        Args:
            x: x [mm].
            y: y [mm].
            heading: Heading [rad].
        """
        self.robots.place(self.row, x, y, heading)


class EmulatedRobots:
    """The true motion of N robots, in the spec's axes.

    The counts of the motors are read once per millisecond, as the firmware does. All robots stand
    still at first.

    Args:
        robots: The robots.
        drivetrains: Converts counts to true wheel speeds [mm/s].
        radius: Distance from a wheel to the robot's centre, shape (N,) [mm].
        lag_s: Time constants of the wheels, shape (N,) [s].
        start_ns: The present time [ns].

    Attributes:
        robots: The robots.
        pose: x, y [mm] and heading [rad], shape (3, N).
        wheels: Speeds of the left and right wheels, shape (2, N) [mm/s].
    """

    def __init__(
        self,
        robots: Sequence[EmulatedRobot],
        drivetrains: Drivetrains,
        radius: Floats,
        lag_s: Floats,
        start_ns: int = 0,
    ) -> None:
        at_zero = Poses(*np.zeros((3, len(robots))))
        self._wheeled = WheeledRobots(at_zero, radius, lag_s, AT_REST_MM_S)
        self._wheeled.roll = roll
        self._wheeled.drive(start_ns, np.array([start_ns]))  # loads the compiled code
        self.robots = robots
        self.pose = self._wheeled.pose
        self.wheels = self._wheeled.wheels
        self._drivetrains = drivetrains
        self._now_ns = start_ns
        self._motor_drives: list[
            MotorDrive
        ] = []  # one entry per robot; empty before the first step
        self._is_driven = False  # whether wheels follow a speed that is not 0
        for row, robot in enumerate(robots):
            robot.robots = self
            robot.row = row

    @property
    def now_ms(self) -> int:
        """The present time [ms], for the robots' programs."""
        return self._now_ns // MILLISECOND

    def advance(self, until_ns: int) -> None:
        """Advance the robots to the time `until_ns` [ns].

        The steps are at most a millisecond long, because watchdogs can expire at each millisecond.
        """
        wheeled = self._wheeled
        while self._now_ns < until_ns:
            drives: list[MotorDrive] = [
                (robot.counts(), (robot.speed_fraction("left"), robot.speed_fraction("right")))
                for robot in self.robots
            ]
            if drives != self._motor_drives:
                self._motor_drives = drives
                counts, fractions = (np.array(values).T for values in zip(*drives, strict=True))
                wheeled.targets[:] = fractions * self._drivetrains.speeds(counts)
                self._is_driven = bool(wheeled.targets.any())
                is_stuck = fractions == 0
                wheeled.wheels[is_stuck] = 0.0  # a stuck wheel stops at once
            since_ns = self._now_ns
            self._now_ns = min(since_ns + MILLISECOND, until_ns)
            if self._is_driven or wheeled.wheels.any():
                wheeled.drive(since_ns, np.array([self._now_ns]))

    def place(self, row: int, x: float, y: float, heading: float) -> None:
        """Put a robot at a pose, at standstill.

        Args:
            row: Index of the robot.
            x: x [mm].
            y: y [mm].
            heading: Heading [rad].
        """
        self.pose[:, row] = x, y, heading
        self.wheels[:, row] = 0.0

    def shift(self, row: int, x: float, y: float, turn: float) -> None:
        """Displace and turn a robot without changing its wheel speeds.

        Args:
            row: Index of the robot.
            x: Displacement in x [mm].
            y: Displacement in y [mm].
            turn: Angle by which it is turned [rad].
        """
        self.pose[:, row] += x, y, turn
