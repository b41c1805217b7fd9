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
from tetractl_toio.camera import placed
from tetractl_toio.emulated.cube import ns
from tetractl_toio.emulated.side import ConnectedCube
from tetractl_toio.messages import Characteristic, CubeReading, encode_reading, pack
from tetractl_toio.section import ToioCameraSection

# the print of toio Collection's mat, both sides [units of the mat]
LEFT = 45
RIGHT = 955
TOP = 45
BOTTOM = 455


class MatSettings(Model):
    """Properties of the emulated mat readings that a fault script can change."""

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

    Each cube reads the mat at a fixed interval. A report that reaches the program counts as one
    exposure and one frame.

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
        self.last: list[CubeReading | None] = [None] * len(self.cubes)
        self.join = stage.wires.ports
        self.acting = stage.acting
        self.shown_ns = [0] * len(bodies)
        self._stage = stage
        self._section = section
        self._exposures = 0
        self._every_ns = ns(settings.notify)

    def open(self, loop: Loop) -> Facts:
        """Start the readings of all cubes, each with a random phase.

        Returns:
            One entry: "camera" maps to a description for display.
        """
        random = Random(self._stage.options.seed)
        for i in range(len(self.cubes)):
            start_ns = self._stage.timeline.now_ns + random.randrange(self._every_ns)
            self._stage.timeline.at(start_ns, lambda i=i: self._read(i))
        return {"camera": f"{len(self.cubes)} cubes on a mat"}

    def close(self) -> Facts:
        """Return how many readings the cubes have reported, under the key "frames"."""
        return {"frames": self._exposures}

    def _read(self, i: int) -> None:
        """Schedule a cube's next reading, let the cube read the mat, and report it if necessary.

        A cube reports only if it was asked or if notifications are on. It reports only
        once that it sees no mat.
        """
        timeline = self._stage.timeline
        cube = self.cubes[i]
        timeline.at(timeline.now_ns + self._every_ns, lambda: self._read(i))
        program = cube.program
        last = self.last[i]
        if self.acting.of_kind("no_frames"):
            self._stage.sent(self._exposures)  # so that the fault is recorded without a report
            return
        if not (program.is_notifying or program.is_asked):
            return
        present = self._reading(cube)
        if not self.acting.of_kind("freeze"):
            self.last[i] = present
        newest = self.last[i]
        if newest is None and last is None and not program.is_asked:
            return  # that it sees no mat it says once, and when it is asked
        program.is_asked = False
        message = pack(Characteristic.ID, encode_reading(newest))
        at_ns = timeline.now_ns
        # a frozen reading of a cube that stands is as good as a new one
        shows_place = newest is not None and newest == present
        cube.connection.notify(message, lambda: self._passed(i, shows_place, at_ns))

    def _reading(self, cube: ConnectedCube) -> CubeReading | None:
        """Return what a cube reads now, including faults.

        The result is None if the robots are carried, if a fault hides the cube, or if it is
        outside the printed part of the mat.
        """
        x = cube.x
        y = cube.y
        for jump in self.acting.of_kind("jump", cube.name):
            x += jump.by[0]
            y += jump.by[1]
        origin = self._section.origin
        unit = self._section.unit_mm
        reading = placed((x, y, cube.heading), origin, unit)
        printed = LEFT <= reading.x <= RIGHT and TOP <= reading.y <= BOTTOM
        hidden = self.acting.robots_are_carried or self.acting.of_kind("untracked", cube.name)
        return None if hidden or not printed else reading

    def _passed(self, i: int, shows_place: bool, at_ns: int) -> None:
        """Record a report that has reached the program.

        Args:
            i: Index of the cube.
            shows_place: Whether the report shows where the cube truly was.
            at_ns: When the cube was read [ns].
        """
        self._exposures += 1
        self._stage.exposed(self._exposures, self._exposures)
        if shows_place:
            self.shown_ns[i] = max(self.shown_ns[i], at_ns)
        self._stage.sent(self._exposures)
