"""Joins poses that arrive one by one to frames. Poses with the same time stamp belong together.

A motion-capture node sends one message for each body, all with the same stamp. A frame is complete
once all robots of the previous frames have arrived. Robots that localise themselves have different
stamps. Each of their poses then is a frame, in which the other robots keep their last poses and
times.

    group = FrameGroup(robots=3)
    group.add(stamp, {0: RobotReading(pose, exposed_ns)})     [] or the readings of all robots
"""

from collections.abc import Mapping
from dataclasses import dataclass

from tetractl.core.poses import Pose


@dataclass(frozen=True, slots=True)
class RobotReading:
    """The pose of a robot, or None if it is not tracked, with the time of its exposure [ns]."""

    pose: Pose | None
    exposed_ns: int


NOTHING = RobotReading(None, 0)
"""Reading of a robot before its first reading."""
Readings = tuple[RobotReading, ...]
"""The last readings of all robots, in the setup's order."""


class FrameGroup:
    """Collects the readings of N robots until a frame is complete.

    A pose that arrives after its frame was completed is shown in the next frame. From then on, its
    robot is waited for. If such a robot is missing, the frame is completed when a pose with another
    stamp arrives. The robot is then no longer waited for.
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
        """The last reading of each robot, in the setup's order."""
        return tuple(self._last)

    def add(self, stamp: int, readings: Mapping[int, RobotReading]) -> list[Readings]:
        """Add readings that have the same time stamp.

        Args:
            stamp: The stamp in their header, on any clock.
            readings: The readings, by the robots' indices in the setup.

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
        """Complete the pending frame, and return each robot's last reading, in the setup's order.

        Robots that are not in the pending frame keep their older reading.
        """
        if len(self._pending) > 1:
            self._in_step = self._pending
        elif self._pending <= self._in_step:
            self._in_step = set()
        self._closed = self._pending
        self._closed_stamp = self._pending_stamp
        self._pending = set()
        return self.last
