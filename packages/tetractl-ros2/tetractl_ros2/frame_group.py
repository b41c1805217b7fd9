"""Collects poses that come one by one to frames: poses with one stamp belong together.

A motion-capture node sends one message for each body, all with the same stamp: a frame is complete
once every robot that kept step before has come. Robots that localise themselves have stamps of
their own: each of their poses is a frame, in which the others keep their last poses and times.

    group = FrameGroup(robots=3)
    group.add(stamp, {0: RobotReading(pose, exposed_ns)})     [] or the readings of all robots
"""

from collections.abc import Mapping
from dataclasses import dataclass

from tetractl.core.poses import Pose


@dataclass(frozen=True, slots=True)
class RobotReading:
    """The pose of a robot, None if it is not tracked, and when it was there [ns]."""

    pose: Pose | None
    exposed_ns: int


NOTHING = RobotReading(None, 0)
"""What is known of a robot before its first reading."""
Readings = tuple[RobotReading, ...]
"""The last readings of all robots, in the setup's order."""


class FrameGroup:
    """The last readings of N robots, and the frame that is being collected.

    A pose that comes after its frame is complete is shown in the next frame, and starting with that
    one its robot is waited for. A frame that lacks such a robot is complete when a pose with
    another stamp comes; then the robot is no longer waited for.
    """

    def __init__(self, robots: int) -> None:
        self._last = [NOTHING] * robots
        self._in_step = set[int]()  # robots that a frame waits for
        self._pending = set[int]()  # robots of the frame that is being collected
        self._pending_stamp = -1
        self._closed = set[int]()  # robots of the last complete frame
        self._closed_stamp = -1

    @property
    def last(self) -> Readings:
        """The last readings of all robots."""
        return tuple(self._last)

    def add(self, stamp: int, readings: Mapping[int, RobotReading]) -> list[Readings]:
        """Take readings with one stamp.

        Args:
            stamp: The time in their header, on whatever clock.
            readings: The readings, by the robots' places in the setup.

        Returns:
            The frames that are now complete, oldest first: none, one or two.
        """
        complete: list[Readings] = []
        if self._pending and stamp != self._pending_stamp:
            complete.append(self._close())
        for robot, reading in readings.items():
            if reading.exposed_ns >= self._last[robot].exposed_ns:
                self._last[robot] = reading
        if stamp == self._closed_stamp:
            self._in_step = self._in_step | self._closed | set(readings)
            return complete
        self._pending |= set(readings)
        self._pending_stamp = stamp
        waits = self._pending & self._in_step and not self._in_step <= self._pending
        if not waits:
            complete.append(self._close())
        return complete

    def _close(self) -> Readings:
        """Complete the pending frame; return the readings of all robots."""
        if len(self._pending) > 1:
            self._in_step = self._pending
        elif self._pending <= self._in_step:
            self._in_step = set()
        self._closed = self._pending
        self._closed_stamp = self._pending_stamp
        self._pending = set()
        return self.last
