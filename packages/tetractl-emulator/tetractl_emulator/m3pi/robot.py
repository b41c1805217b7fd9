"""Robots on two wheels, emulated: what a program in each makes of what it hears, and how they move.

An `EmulatedRobot` is one robot's electronics: by default it runs the real firmware's core, which
reads the bytes of the radio and gives both motors a number of counts. `EmulatedRobots` moves all of
them: each wheel follows the speed of its counts with a first-order lag, and a robot of wheel speeds
l, r and wheel distance d from its centre drives at (l + r) / 2 and turns at (r - l) / (2 d), by
`model.wheels`. Lengths are mm, speeds mm/s, times ms in a program and ns elsewhere.
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

STANDING_MM_S = 1.0
AT_REST_MM_S = 1e-9
FULL_LOAD_MM_S = 2000.0  # both wheels together
ON_MS = 10_000  # how long robots have been on when an emulation begins
BATTERY_MV = 5100  # of four NiMH cells, without load
SAG_MV = 150.0  # at full load
Speeds = tuple[float, float]
"""The speeds of a robot's left and right wheel [mm/s]."""


Held = tuple[Counts, tuple[float, float]]
"""What a robot's motors are given, and the share of its speed at which each wheel turns."""


class Program(Protocol):
    """What a robot's microcontroller runs, such as a `WheelsCore`. Times are milliseconds."""

    def push(self, data: bytes, now_ms: int) -> Any:
        """Read bytes from the radio."""
        ...

    def wheels(self, now_ms: int) -> Counts:
        """Return the present counts of both motors."""
        ...

    def status(self, now_ms: int) -> Status:
        """Return whether the robot runs, is emergency-stopped or silent."""
        ...

    def take_reply(self, now_ms: int) -> bytes:
        """Return the bytes to send now, each once."""
        ...

    def set_battery(self, battery_mv: int) -> None:
        """Take the battery's voltage [mV]."""
        ...


class EmulatedRobot:
    """One robot with its program. `EmulatedRobots` moves it.

    Args:
        name: Its name.
        index: The number in broadcasts that was built into its firmware.
        battery_mv: Voltage of its battery [mV].
        make_core: Creates the program for an index.
        acting: The faults that act now, of which it has those that name it. None for none.
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
        self._switched_on_ms = 0  # from when on its program counts
        self.core = self._core_of_long_ago()
        self._unloaded_mv = battery_mv
        self.powered = True
        self.acting = acting or ActingFaults()

    @property
    def x(self) -> float:
        """Position x [mm]."""
        return float(self.robots.pose[0, self.row])

    @property
    def y(self) -> float:
        """Position y [mm]."""
        return float(self.robots.pose[1, self.row])

    @property
    def heading(self) -> float:
        """Heading [rad]."""
        return float(self.robots.pose[2, self.row])

    @property
    def wheels(self) -> Speeds:
        """The speeds of the left and the right wheel [mm/s]."""
        left, right = self.robots.wheels
        return float(left[self.row]), float(right[self.row])

    @property
    def standing(self) -> bool:
        """Whether both wheels are at rest, or turn more slowly than a camera could detect."""
        return max(map(abs, self.wheels)) < STANDING_MM_S

    def hear(self, data: bytes) -> None:
        """Take bytes from the robot's radio module."""
        if self.powered:
            self.core.set_battery(self._battery_mv())
            self.core.push(data, self._now_ms)

    def _battery_mv(self) -> int:
        """Return the battery's voltage under the present load [mV]."""
        low = self.acting.newest("low_battery", self.name)
        if low is not None:
            return low.millivolts
        load = min(1.0, sum(map(abs, self.wheels)) / FULL_LOAD_MM_S)
        return max(0, round(self._unloaded_mv - SAG_MV * load))

    @property
    def late_ns(self) -> int:
        """By how much it obeys late what it receives [ns]."""
        return round(self.acting.total_by("reboots", self.name) * SECOND)

    def answer(self) -> bytes:
        """Return the bytes that the robot now sends to its radio module."""
        return self.core.take_reply(self._now_ms) if self.powered else b""

    @property
    def status(self) -> Status:
        """What its program reports."""
        return self.core.status(self._now_ms)

    def counts(self) -> Counts:
        """Return the present counts of both motors."""
        if not self.powered:
            return 0, 0
        counts = self.core.wheels(self._now_ms)
        veer = self.acting.newest("veer", self.name) if any(counts) else None
        return counts if veer is None else veer.counts

    def speed_fraction(self, wheel: str) -> float:
        """Return the share of its speed at which the left or the right wheel turns."""
        if not self.acting.any_yet:
            return 1.0
        if any(f.wheel in (wheel, "both") for f in self.acting.of_kind("wheel_stuck", self.name)):
            return 0.0
        weak = self.acting.of_kind("weak_wheel", self.name)
        return min((fault.share for fault in weak if fault.wheel in (wheel, "both")), default=1.0)

    def switch(self, on: bool) -> None:
        """Switch the robot on or off; switching it on restarts its firmware."""
        self.powered = on
        if on:
            self._switched_on_ms = self.robots.now_ms
            self.core = self._make_core(self.index)

    def renumber(self, index: int) -> None:
        """Give the robot a firmware with another number."""
        self.index = index
        self.core = self._core_of_long_ago()

    def _core_of_long_ago(self) -> Program:
        """Return a program that has run for ON_MS."""
        core = self._make_core(self.index)
        core.wheels(ON_MS)
        return core

    @property
    def _now_ms(self) -> int:
        """The time of the robot's program, since it was switched on [ms]."""
        return self.robots.now_ms - self._switched_on_ms

    def place(self, x: float, y: float, heading: float) -> None:
        """Put the robot at a pose, standing still.

        Args:
            x: x [mm].
            y: y [mm].
            heading: Heading [rad].
        """
        self.robots.place(self.row, x, y, heading)


class EmulatedRobots:
    """The true state of N robots, in the spec's axes.

    The robots stand still at the start. The motors' counts are read once a millisecond, as the
    firmware does.

    Args:
        robots: The robots.
        drivetrains: Converts counts to true wheel speeds.
        radius: Distance from a wheel to the centre [mm], shape (N,).
        lag_s: Time constants of the wheels [s], shape (N,).
        start_ns: Time of the start [ns].

    Attributes:
        pose: x, y [mm] and heading [rad], shape (3, N).
        wheels: Speeds of the left and right wheels [mm/s], shape (2, N).
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
        self._wheeled.drive(start_ns, np.array([start_ns]))  # so that the code is loaded before
        self.robots = robots
        self.pose = self._wheeled.pose
        self.wheels = self._wheeled.wheels
        self._drivetrains = drivetrains
        self._now_ns = start_ns
        self._held: list[Held] = []  # of each robot; [] if not yet read
        self._driven = False  # whether wheels follow a speed that is not 0
        for row, robot in enumerate(robots):
            robot.robots = self
            robot.row = row

    @property
    def now_ms(self) -> int:
        """The time of the robots' firmware [ms]."""
        return self._now_ns // MILLISECOND

    def advance(self, until_ns: int) -> None:
        """Advance to `until_ns`, in steps of at most a millisecond, as watchdogs end."""
        wheeled = self._wheeled
        while self._now_ns < until_ns:
            held: list[Held] = [
                (robot.counts(), (robot.speed_fraction("left"), robot.speed_fraction("right")))
                for robot in self.robots
            ]
            if held != self._held:
                self._held = held
                counts, shares = (np.array(values).T for values in zip(*held, strict=True))
                wheeled.targets[:] = shares * self._drivetrains.speeds(counts)
                self._driven = bool(wheeled.targets.any())
                is_stuck = shares == 0
                wheeled.wheels[is_stuck] = 0.0  # it stands at once
            since_ns = self._now_ns
            self._now_ns = min(since_ns + MILLISECOND, until_ns)
            if self._driven or wheeled.wheels.any():
                wheeled.drive(since_ns, np.array([self._now_ns]))

    def place(self, row: int, x: float, y: float, heading: float) -> None:
        """Put a robot at a pose, standing still.

        Args:
            row: Index of the robot.
            x: x [mm].
            y: y [mm].
            heading: Heading [rad].
        """
        self.pose[:, row] = x, y, heading
        self.wheels[:, row] = 0.0

    def shift(self, row: int, x: float, y: float, turn: float) -> None:
        """Move a robot without stopping its wheels.

        Args:
            row: Index of the robot.
            x: Displacement in x [mm].
            y: Displacement in y [mm].
            turn: Angle by which it is turned [rad].
        """
        self.pose[:, row] += x, y, turn
