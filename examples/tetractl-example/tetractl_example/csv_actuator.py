"""`actuator: {type: csv-actuator}`: write the common direction to a CSV file.

The columns are time_s, action and direction_rad, and each row is one command to all robots: `steer`
(drive, and turn towards the direction), `turn` (stand, and turn towards it) or `stop` (no
direction). It suits robots that turn by themselves, and that another program steers by the file.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Literal, Self, TextIO

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Action, Steer, Stop, Transmission, Turn
from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.core.protocols import Health, RobotStatus
from tetractl.core.setup import Setup
from tetractl.lab.guard_checks import GuardChecks, robot_checks
from tetractl.lab.guard_rules import GuardRules
from tetractl.model.motion.exact import rates
from tetractl.model.motion.wheel_equations import wheel_speeds
from tetractl.spec.base import Positive
from tetractl.spec.lab_section import ActuatorSection


class CsvActuatorSection(ActuatorSection):
    """Robots that another program steers by the rows of a CSV file."""

    type: Literal["csv-actuator"]
    checks: ClassVar[str] = "tetractl_example.csv_actuator:checks_of_robots_that_stop_together"
    file: str
    """The file, to which rows are appended."""
    rate: Positive = 20.0
    """Rows per second while a direction is held [Hz]."""

    def build(self, setup: Setup, clock: Clock) -> "CsvActuator":
        """Return the actuator of the setup's robots, in their order."""
        return CsvActuator(self, setup, clock)


def checks_of_robots_that_stop_together(rules: GuardRules) -> GuardChecks:
    """Return the guard's usual checks, for robots of which none can be held while others drive."""
    return replace(robot_checks(rules), together=True)


class CsvActuator:
    """All robots read the same rows; an `Actuator`."""

    halts = True

    def __init__(self, section: CsvActuatorSection, setup: Setup, clock: Clock) -> None:
        self.period_ns = round(SECOND / section.rate)
        self.failure: str | None = None
        self._path, self._setup, self._clock = Path(section.file), setup, clock
        self._file: TextIO | None = None

    def __enter__(self) -> Self:
        try:
            self._file = self._path.open("a", buffering=1, encoding="utf-8")  # each row at once
        except OSError as error:
            raise AbortError(f"{self._path}: {error.strerror}") from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def check(self) -> Health:
        """Return what is wrong, and for the log the file's name."""
        return Health((self.failure,) if self.failure else (), facts={"csv_file": str(self._path)})

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Return a status for each robot that says that it cannot answer."""
        return [RobotStatus(answers=None)] * len(self._setup.names)

    def send(
        self,
        action: Steer | Turn,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        """Append a direction; see `Actuator.send`. `moving` is True for all robots."""
        if self.failure is not None:
            raise AbortError(self.failure)
        steers = isinstance(action, Steer)
        direction = action.direction if steers else action.facing
        speed = self._setup.speed if steers else np.zeros_like(self._setup.speed)
        headings = np.array([direction if pose is None else pose.heading for pose in poses])
        _, _, turning = rates(headings, direction, self._setup.a, speed)
        name = "steer" if steers else "turn"
        return self._write(action, f"{name},{direction:.6f}", speed, turning)

    def stop(self, emergency: bool = False) -> Transmission:
        """Append a stop, also after a failure; see `Actuator.stop`. A file latches no stop."""
        still = np.zeros_like(self._setup.speed)
        return self._write(Stop(), "stop,", still, still)

    def _write(
        self, action: Action, words: str, speed: np.ndarray, turning: np.ndarray
    ) -> Transmission:
        """Append a row, and return it as the robots' speeds and turning rates by (1) to (3)."""
        sent_ns = self._clock.now()
        try:
            if self._file is None:
                raise AbortError(f"{self._path}: is not open")
            self._file.write(f"{sent_ns / SECOND:.6f},{words}\n")
        except OSError as error:
            self.failure = f"{self._path}: {error.strerror}"
            raise AbortError(self.failure) from error
        left = right = None
        if self._setup.wheel_radius is not None:
            left, right = wheel_speeds(1.0, turning, speed, self._setup.wheel_radius)
        received = (True,) * len(self._setup.names)
        return Transmission(action, sent_ns, received, left, right, speed=speed, turning=turning)
