"""The emulated camera of type `toio`: emulated cubes that read a mat and report their poses."""

from collections.abc import Sequence
from random import Random
from typing import Annotated, ClassVar

from pydantic import Field
from tetractl_emulator.fault_rows import CAMERA_REASONS, MOVED_REASONS, FaultRow, scaled_vector
from tetractl_emulator.faults import Fault, Visible, fault_kind
from tetractl_emulator.loop import Loop
from tetractl_emulator.sides import Body, Facts, Stage

from tetractl.core.errors import SpecError
from tetractl.spec.base import Model, Name, Point
from tetractl_toio.camera import compute_reading
from tetractl_toio.emulated.cube import to_whole_ms_ns
from tetractl_toio.emulated.side import ConnectedCube
from tetractl_toio.messages import Characteristic, CubeReading, encode_reading, pack
from tetractl_toio.section import ToioCameraSection

# edges of the printed part of toio Collection's mat, on both sides [units of the mat]
PRINT_LEFT = 45
PRINT_RIGHT = 955
PRINT_TOP = 45
PRINT_BOTTOM = 455


class MatSettings(Model):
    """Properties of the readings of the emulated mat that a fault script can change."""

    notify: Annotated[float, Field(ge=0.01, le=1)] = 0.01
    """Time between two readings of a cube [s]."""


SENT = Visible.SENT
EXPOSED = Visible.EXPOSED
FAULTS = (
    fault_kind(
        "no_frames", "No cube reports.", SENT, rows=[FaultRow("frames lost", CAMERA_REASONS)]
    ),
    fault_kind(
        "freeze",
        "All cubes repeat their last report again and again.",
        SENT,
        rows=[FaultRow("frames frozen", CAMERA_REASONS)],
    ),
    fault_kind(
        "untracked",
        "A cube does not see the mat.",
        EXPOSED,
        fields={"robot": Name},
        rows=[FaultRow("untracked", CAMERA_REASONS)],
    ),
    fault_kind(
        "jump",
        "A cube reads a wrong place on the mat, off by this distance [mm].",
        EXPOSED,
        fields={"robot": Name, "by": Point},
        rows=[FaultRow("pose jumps", MOVED_REASONS, {"by": scaled_vector(5, 500)})],
    ),
)


class EmulatedMat:
    """The mat under emulated cubes, and the schedule of their readings.

    Each cube reads the mat at a fixed interval. Each report that reaches the program counts as an
    exposure and a frame.

    Args:
        stage: The data and functions that the emulated devices share.
        settings: Properties of the readings that differ from the spec.
        bodies: The cubes of the emulated actuator of type `toio`.

    Raises:
        SpecError: If the actuator is of another type.
    """

    Settings: ClassVar[type[Model]] = MatSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS

    def __init__(self, stage: Stage, settings: MatSettings, bodies: Sequence[Body]) -> None:
        section = stage.lab.camera
        assert isinstance(section, ToioCameraSection), "the camera's section has the type toio"
        self.cubes = [body for body in bodies if isinstance(body, ConnectedCube)]
        if len(self.cubes) != len(bodies):
            raise SpecError(
                "a camera of type toio can be emulated only together with an actuator of type toio"
            )
        self.last_readings: list[CubeReading | None] = [None] * len(self.cubes)
        self.join = stage.wires.ports
        self.acting = stage.acting
        self.shown_ns = [0] * len(bodies)
        self._stage = stage
        self._section = section
        self._report_count = 0
        self._reading_interval_ns = to_whole_ms_ns(settings.notify)

    def open(self, loop: Loop) -> Facts:
        """Schedule the readings of all cubes, each with a random phase.

        Returns:
            One entry: "camera" maps to a description for display.
        """
        random = Random(self._stage.options.seed)
        for i in range(len(self.cubes)):
            start_ns = self._stage.timeline.now_ns + random.randrange(self._reading_interval_ns)
            self._stage.timeline.at(start_ns, lambda i=i: self._update_reading(i))
        return {"camera": f"{len(self.cubes)} cubes on a mat"}

    def close(self) -> Facts:
        """Return the number of readings that the cubes have reported, under the key "frames"."""
        return {"frames": self._report_count}

    def _update_reading(self, i: int) -> None:
        """Let a cube read the mat, report if necessary, and schedule the next reading.

        A cube reports only if a program has asked for a reading, or if notifications are on. It
        reports only once that it sees no mat.
        """
        timeline = self._stage.timeline
        cube = self.cubes[i]
        timeline.at(timeline.now_ns + self._reading_interval_ns, lambda: self._update_reading(i))
        program = cube.program
        last_reading = self.last_readings[i]
        if self.acting.of_kind("no_frames"):
            self._stage.sent(self._report_count)  # so that the fault is recorded without a report
            return
        if not (program.is_notifying or program.is_reading_requested):
            return
        present_reading = self._read_mat(cube)
        if not self.acting.of_kind("freeze"):
            self.last_readings[i] = present_reading
        newest_reading = self.last_readings[i]
        if newest_reading is None and last_reading is None and not program.is_reading_requested:
            return  # it reports only once, or on request, that it sees no mat
        program.is_reading_requested = False
        message = pack(Characteristic.ID, encode_reading(newest_reading))
        read_ns = timeline.now_ns
        # a frozen reading of a stationary cube is as good as a new reading
        shows_place = newest_reading is not None and newest_reading == present_reading
        cube.connection.notify(message, lambda: self._record_report(i, shows_place, read_ns))

    def _read_mat(self, cube: ConnectedCube) -> CubeReading | None:
        """Compute what a cube reads from the mat now, including faults.

        The result is None if the robots are carried, if a fault hides the cube, or if the cube is
        outside the printed part of the mat.
        """
        x = cube.x
        y = cube.y
        for jump in self.acting.of_kind("jump", cube.name):
            x += jump.by[0]
            y += jump.by[1]
        origin = self._section.origin
        unit = self._section.unit_mm
        reading = compute_reading((x, y, cube.heading), origin, unit)
        is_on_print = (
            PRINT_LEFT <= reading.x <= PRINT_RIGHT and PRINT_TOP <= reading.y <= PRINT_BOTTOM
        )
        is_hidden = self.acting.robots_are_carried or self.acting.of_kind("untracked", cube.name)
        return None if is_hidden or not is_on_print else reading

    def _record_report(self, i: int, shows_place: bool, read_ns: int) -> None:
        """Record a report that has reached the program.

        Args:
            i: Index of the cube.
            shows_place: Whether the report shows where the cube truly was.
            read_ns: When the cube read the mat [ns].
        """
        self._report_count += 1
        self._stage.exposed(self._report_count, self._report_count)
        if shows_place:
            self.shown_ns[i] = max(self.shown_ns[i], read_ns)
        self._stage.sent(self._report_count)
