"""A `Camera` for toio cubes on a mat: each cube measures its own pose, at its own times."""

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Self

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.errors import AbortError, WireError
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.lab.serial_port import PortFactory
from tetractl.lab.udp_port import SCHEME
from tetractl.spec.lab_section import entry
from tetractl_toio.cubes import CONNECTION_HINT, UDP_HINT, CubesLink
from tetractl_toio.messages import (
    NOTIFY_MISSED,
    NOTIFY_READINGS,
    Characteristic,
    CubeReading,
    decode_reading,
)
from tetractl_toio.section import ToioCameraSection

FIRST_REPORT_MAX_S = 3.0  # longest time until every cube has reported
REQUESTS_MAX = 5  # number of requests in this time: messages may be lost
NEVER_NS = -1  # time of a report that a cube has not sent
SILENCE_MAX_NS = SECOND // 10  # time of silence after which a cube is asked, and again


@dataclass(frozen=True, slots=True)
class CubeReport:
    """The last report of a cube.

    Attributes:
        pose: The pose that the cube read. None if it sees no mat.
        read_ns: When the report arrived [ns]. Negative before the first report.
    """

    pose: Pose | None = None
    read_ns: int = NEVER_NS


class CubeReports:
    """The last report of each of N cubes. Safe to write and read from different threads."""

    def __init__(self, n_cubes: int) -> None:
        self._newest = [CubeReport()] * n_cubes
        self._report_count = 0
        self._lock = threading.Lock()

    def note_pose(self, i: int, pose: Pose | None, at_ns: int) -> None:
        """Record a report of a cube.

        Args:
            i: Index of the cube.
            pose: The pose that it read. None if it sees no mat.
            at_ns: When the report arrived [ns].
        """
        with self._lock:
            self._newest[i] = CubeReport(pose, at_ns)
            self._report_count += 1

    def now(self) -> tuple[int, list[CubeReport]]:
        """Return the number of reports so far, and each cube's last report, in the cubes' order."""
        with self._lock:
            return self._report_count, [*self._newest]


class ToioCamera:
    """Tracks robots by their cubes' own readings; see `tetractl.core.protocols.Camera`.

    A frame contains the newest reading of every cube. A cube without a new reading keeps its last
    one, with its old time. The number of a frame is the number of reports so far.

    Args:
        section: The camera's section of the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        wake: Called when a report has arrived.
        ports: Creates the port to a cube. None for the default.
    """

    def __init__(
        self,
        section: ToioCameraSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
        ports: PortFactory | None = None,
    ) -> None:
        self.section = section
        self.setup = setup
        self.damaged = 0
        self._clock = clock
        self._wake = wake
        cubes = [entry(section.robots, name).cube for name in setup.names]
        self._link = CubesLink(clock, cubes, ports, self._receive)
        self._reports = CubeReports(len(cubes))
        self._configured = set[int]()  # the cubes that have taken the settings
        self._asked_ns = 0  # when silent cubes were last asked
        self._newest_ns = NEVER_NS  # time of the newest report in a frame

    def __enter__(self) -> Self:
        """Connect, and return once every cube has reported.

        Raises:
            AbortError: If a cube cannot be reached or does not report. The message names the
                robots.
        """
        try:
            self._link.open()
            for _ in range(REQUESTS_MAX):
                if self._begin_reports():
                    break
            silent = self._silent_names()
            if silent:
                hint = UDP_HINT if self._link.cubes[0].startswith(SCHEME) else CONNECTION_HINT
                raise AbortError(f"no message came from {', '.join(silent)}", hint)
        except BaseException:
            self._link.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()

    def _begin_reports(self) -> bool:
        """Ask every cube to report, and wait for the answers.

        Returns:
            Whether every cube has reported. If not, try again: messages can be lost.
        """
        for cube in self._link.cubes:
            for setting in (NOTIFY_READINGS, NOTIFY_MISSED):
                self._link.send(cube, Characteristic.CONFIGURATION, setting)
            self._link.send(cube, Characteristic.ID)
        n_cubes = len(self._link.cubes)
        return wait_for(
            self._clock,
            lambda: not self._silent_names() and len(self._configured) == n_cubes,
            FIRST_REPORT_MAX_S / REQUESTS_MAX,
        )

    def _silent_names(self) -> list[str]:
        """Return the names of the robots whose cubes have not reported yet."""
        _, reports = self._reports.now()
        return [
            name
            for name, report in zip(self.setup.names, reports, strict=True)
            if report.read_ns < 0
        ]

    def check(self) -> Health:
        """Check whether every cube sees the mat, and report a problem for each cube that does not.

        A cube that has not reported yet counts as a cube that does not see the mat.
        """
        _, reports = self._reports.now()
        problems = tuple(
            f"{name} does not see the mat: is the cube on the mat, and is its underside clean?"
            for name, report in zip(self.setup.names, reports, strict=True)
            if report.pose is None
        )
        return Health(problems, emulated=self._link.emulated)

    def frames(self) -> list[CameraFrame]:
        """Return a new frame if a cube has reported since the last call.

        Cubes that have been silent for SILENCE_MAX_NS are asked for a reading.

        Returns:
            One frame, or an empty list if there is nothing new or if a cube has never reported.
        """
        self._ask_silent()
        number, reports = self._reports.now()
        times_ns = [report.read_ns for report in reports]
        newest_ns = max(times_ns)
        if min(times_ns) < 0 or newest_ns <= self._newest_ns:
            return []  # a reading that another cube's has overtaken is in the next frame
        self._newest_ns = newest_ns
        frame = CameraFrame(
            number=number,
            sampled_ns=self._to_sampled_ns(newest_ns),
            received_ns=self._clock.now(),
            poses=tuple(report.pose for report in reports),
            exposed_ns=tuple(map(self._to_sampled_ns, times_ns)),
        )
        return [frame]

    def _ask_silent(self) -> None:
        """Ask each cube that has not reported for SILENCE_MAX_NS for a reading.

        A cube that is lifted off the mat reports this only once, so it must be asked again.
        """
        silent_since_ns = self._clock.now() - SILENCE_MAX_NS
        if self._asked_ns > silent_since_ns:
            return
        self._asked_ns = silent_since_ns + SILENCE_MAX_NS
        _, reports = self._reports.now()
        for cube, report in zip(self._link.cubes, reports, strict=True):
            if report.read_ns <= silent_since_ns:
                with suppress(AbortError):  # the actuator's side says why
                    self._link.send(cube, Characteristic.ID)

    def _to_sampled_ns(self, at_ns: int) -> int:
        """Return the time of a reading [ns]: its time of arrival minus the latency, at least 0."""
        return max(0, at_ns - round(self.section.latency * SECOND))

    def _receive(self, i: int, characteristic: int, data: bytes, at_ns: int) -> None:
        """Record the reading in a notification of cube `i`.

        Notifications that cannot be decoded only raise the count `damaged`.
        """
        if characteristic == Characteristic.CONFIGURATION:
            self._configured.add(i)
        if characteristic != Characteristic.ID:
            return
        try:
            reading = decode_reading(data)
        except WireError:
            self.damaged += 1
            return
        self._reports.note_pose(i, None if reading is None else self._to_pose(reading), at_ns)
        self._wake()

    def _to_pose(self, reading: CubeReading) -> Pose:
        """Convert a reading to a pose in the spec's coordinates, whose y axis points up.

        Lengths are in the spec's unit, and the heading is in radians, anticlockwise.
        """
        unit = self.section.unit_mm / (self.setup.metres * 1000)
        x = reading.x - self.section.origin[0]
        y = self.section.origin[1] - reading.y
        return Pose(x * unit, y * unit, -math.remainder(math.radians(reading.angle), math.tau))


def compute_reading(pose: Sequence[float], origin: tuple[int, int], unit_mm: float) -> CubeReading:
    """Compute the reading of a cube at a pose in the spec's coordinates.

    Args:
        pose: x, y [mm] and heading [rad].
        origin: The spec's origin, in the mat's units.
        unit_mm: Length of one of the mat's units [mm].
    """
    x, y, heading = pose
    angle = round(math.degrees(-heading)) % 360
    return CubeReading(origin[0] + round(x / unit_mm), origin[1] - round(y / unit_mm), angle)
