"""Combines poses that arrive one by one to frames. Poses with the same time stamp belong together.

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
    """A robot's pose and the time of its exposure.

    Attributes:
        pose: The pose. None if the robot is not tracked.
        exposed_ns: Time of the exposure [ns].
    """

    pose: Pose | None
    exposed_ns: int


NO_READING = RobotReading(None, 0)
"""Stands for a robot's reading before the first reading arrives."""
Readings = tuple[RobotReading, ...]
"""The last readings of all robots, in the setup's order."""


class FrameGroup:
    """Collects the readings of N robots until a frame is complete.

    If a pose arrives after its frame was completed, it appears in the next frame, and later frames
    wait for its robot. If an awaited robot is missing, the frame is completed when a pose with
    another stamp arrives. Later frames then no longer wait for the missing robot.

    Args:
        n_robots: Number of robots.
    """

    def __init__(self, n_robots: int) -> None:
        self._last = [NO_READING] * n_robots
        self._awaited = set[int]()  # robots for which a frame waits
        self._pending = set[int]()  # robots of the frame that is being collected
        self._pending_stamp = -1
        self._completed = set[int]()  # robots of the last complete frame
        self._completed_stamp = -1

    @property
    def last(self) -> Readings:
        """The last reading of each robot, in the setup's order."""
        return tuple(self._last)

    def add(self, stamp: int, readings: Mapping[int, RobotReading]) -> list[Readings]:
        """Add readings that have the same time stamp.

        Args:
            stamp: The time stamp of the readings, on any clock.
            readings: The readings, by the robots' indices in the setup.

        Returns:
            The frames that are now complete, oldest first: none, one or two.
        """
        complete: list[Readings] = []
        if self._pending and stamp != self._pending_stamp:
            complete.append(self._complete())
        for robot, reading in readings.items():
            if reading.exposed_ns >= self._last[robot].exposed_ns:
                self._last[robot] = reading
        if stamp == self._completed_stamp:
            self._awaited = self._awaited | self._completed | set(readings)
            return complete
        self._pending |= set(readings)
        self._pending_stamp = stamp
        must_wait = self._pending & self._awaited and not self._awaited <= self._pending
        if not must_wait:
            complete.append(self._complete())
        return complete

    def _complete(self) -> Readings:
        """Complete the pending frame, and return each robot's last reading, in the setup's order.

        Robots that are not in the pending frame keep their older reading.
        """
        if len(self._pending) > 1:
            self._awaited = self._pending
        elif self._pending <= self._awaited:
            self._awaited = set()
        self._completed = self._pending
        self._completed_stamp = self._pending_stamp
        self._pending = set()
        return self.last
