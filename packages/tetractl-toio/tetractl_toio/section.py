"""The sections of the spec for toio cubes: `type: toio` of camera and actuator."""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from tetractl.core.poses import Sight
from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheeled_section import Found, wheel_gains
from tetractl.spec.base import NonNegative, Positive
from tetractl.spec.lab_section import (
    ActuatorSection,
    CameraSection,
    RobotPart,
    mismatches,
    too_fast,
)
from tetractl.spec.yaml.problems import Loc
from tetractl_toio.messages import MAT_MM, RADIUS_MM, WHEEL_MM_S

MatPoint = tuple[Annotated[int, Field(ge=0, le=65_535)], Annotated[int, Field(ge=0, le=65_535)]]


class CubeOfCamera(RobotPart):
    """The entry of one robot in the spec's camera section: which toio cube the robot is."""

    cube: str = Field(min_length=3, max_length=100)
    """The cube: its name, such as toio-M0p, or its Bluetooth address."""


class CubeOfActuator(CubeOfCamera):
    """The entry of one robot in the spec's actuator section: its toio cube and its wheels."""

    left_gain: float = Field(default=1.0, ge=0.2, le=5, allow_inf_nan=False)
    """True speed of the left wheel over its nominal speed."""
    right_gain: float = Field(default=1.0, ge=0.2, le=5, allow_inf_nan=False)
    """True speed of the right wheel over its nominal speed."""
    radius_mm: Positive = Field(default=RADIUS_MM, le=100)
    """Distance r from a wheel to the cube's centre [mm]."""


class ToioCameraSection(CameraSection):
    """toio cubes that read their poses from a printed mat, and report them over Bluetooth."""

    device: ClassVar[str] = "tetractl_toio.camera:ToioCamera"
    type: Literal["toio"]
    origin: MatPoint = (45, 455)
    """The spec's origin in the mat's coordinates, with a y axis that points down.

    Default: the lower left corner of the side with the ring of toio Collection's mat.
    """
    unit_mm: Positive = MAT_MM
    """Length of a unit of the mat's coordinates [mm]."""
    latency: NonNegative = Field(default=0.005, le=0.2)
    """Time from a cube's reading until its message arrives [s]."""
    robots: tuple[CubeOfCamera, ...] = Field(min_length=1, max_length=16)
    """One entry for each robot of the spec."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the location and a message for each mismatch with the spec's robots."""
        yield from mismatches(self.robots, setup.names, ("cube",))
        yield from _addresses(self.robots)

    @property
    def sight(self) -> Sight:
        """The resolution of the mat: one unit for positions, and one degree for headings."""
        return Sight(grid_mm=self.unit_mm, grid_rad=math.radians(1))

    def bounds(self) -> dict[str, str]:
        """Describe the mat for display.

        Returns:
            One entry: "mat" maps to the length of a unit and the spec's origin.
        """
        origin_text = f"the origin is at {self.origin[0]}, {self.origin[1]}"
        return {"mat": f"1 unit of the mat is {self.unit_mm:g} mm; {origin_text}"}


class ToioSection(ActuatorSection):
    """toio cubes, driven over Bluetooth. Each command stops by itself after 250 ms."""

    device: ClassVar[str] = "tetractl_toio.actuator:ToioActuator"
    calibration: ClassVar[str] = "tetractl.lab.calibrate:calibrate_robots"
    stopping: ClassVar[str] = "tetractl_toio.actuator:stop_all"
    dead_zone_max: ClassVar[int] = 0
    type: Literal["toio"]
    rate: float = Field(default=20.0, ge=10, le=50, allow_inf_nan=False)
    """Commands to each cube per second [Hz]."""
    delay: float = Field(default=0.02, ge=0, le=0.2, allow_inf_nan=False)
    """Time from the sending of a command until the wheels follow it [s]."""
    speed_max_mm_s: Positive = Field(default=300.0, le=320)
    """Maximum wheel speed that is sent [mm/s]."""
    battery_warn: float = Field(default=20.0, ge=0, le=100)
    """A warning is printed for a cube below this charge [%]."""
    robots: tuple[CubeOfActuator, ...] = Field(min_length=1, max_length=16)
    """One entry for each robot of the spec."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the location and a message for each mismatch with the spec's robots.

        A robot that is faster than `speed_max_mm_s` is reported, too.
        """
        yield from mismatches(self.robots, setup.names, ("cube",))
        yield from _addresses(self.robots)
        yield from too_fast(setup, self.speed_max_mm_s)

    def beside(self, camera: CameraSection) -> Iterator[tuple[Loc, str]]:
        """Yield an error for each robot whose cube differs from its cube in the camera's section.

        Cameras of other types, and robots that the camera does not list, yield none.
        """
        cubes = isinstance(camera, ToioCameraSection)
        camera_cubes = {robot.name: robot.cube for robot in camera.robots} if cubes else {}
        for i, robot in enumerate(self.robots):
            camera_cube = camera_cubes.get(robot.name, robot.cube)
            if camera_cube != robot.cube:
                text = (
                    f"differs from the cube of {robot.name} in the section 'camera', which is "
                    f"{camera_cube}; name the same cube in both"
                )
                yield ("robots", i, "cube"), text

    def outputs(self, name: str, limit: int) -> tuple[float, int]:
        """Convert a limit on the motor counts to the cubes' units of motor speed.

        Args:
            name: The robot. Ignored, because all cubes are the same.
            limit: A wheel speed in 127ths of the maximum wheel speed, `speed_max_mm_s`.

        Returns:
            The units for one 127th of the maximum wheel speed, and the whole units for `limit`.
        """
        unit = self.speed_max_mm_s / WHEEL_MM_S / 127
        return unit, int(unit * limit)

    def measured(self, result: Found) -> dict[str, Any]:
        """Convert the result of a calibration to a cube's `radius_mm` and wheel gains."""
        return wheel_gains(result, WHEEL_MM_S)

    def bounds(self) -> dict[str, str]:
        """Describe the cubes for display.

        Returns:
            Two entries: "cubes" maps to the names and the command rate, and "wheel speeds" to the
            maximum speed and the speed of one unit.
        """
        cubes = ", ".join(robot.cube for robot in self.robots)
        return {
            "cubes": f"{cubes}, {self.rate:g} commands per second each",
            "wheel speeds": (
                f"at most {self.speed_max_mm_s:g} mm/s; 1 unit of a motor is {WHEEL_MM_S:.2f} mm/s"
            ),
        }


def _addresses(robots: Sequence[CubeOfCamera]) -> Iterator[tuple[Loc, str]]:
    """Yield an error for each emulated cube whose name is not a valid UDP address."""
    from tetractl.lab.udp_port import SCHEME, parse_address

    for i, robot in enumerate(robots):
        if robot.cube.startswith(SCHEME) and parse_address(robot.cube) is None:
            yield ("robots", i, "cube"), f"must be {SCHEME}HOST:PORT"
