"""The section of the spec for motion capture: `camera: {type: motioncapture, ...}`."""

from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.lab.cameras.optitrack.section import TrackedRobot
from tetractl.spec.base import Angle, NonNegative, Point
from tetractl.spec.lab_section import CameraSection, entry, mismatches
from tetractl.spec.yaml.problems import Loc


class MotionCaptureSection(CameraSection):
    """Motion capture of many brands, with libmotioncapture in a process of its own."""

    device: ClassVar[str] = "tetractl_motioncapture.camera:MotionCapture"
    type: Literal["motioncapture"]
    system: Literal["vicon", "qualisys", "vrpn", "nokov", "fzmotion", "optitrack"]
    """The make, as libmotioncapture names it."""
    hostname: str = Field(min_length=1, max_length=500)
    """The computer that streams; udp://HOST:PORT for an emulated one."""
    options: dict[str, str] = Field(default={}, max_length=20)
    """Further arguments of `motioncapture.connect`, such as the port."""
    up_axis: Literal["y", "z"] = "z"
    """The axis that points up."""
    origin: Point = (0.0, 0.0)
    """Position of the cameras' origin in the spec's coordinates [length unit]."""
    rotation: Angle = 0.0
    """Angle from the spec's x axis to the cameras' x axis [rad]."""
    latency: NonNegative = Field(default=0.01, le=0.2)
    """Time from an exposure until its poses arrive [s]."""
    robots: tuple[TrackedRobot, ...] = Field(min_length=1, max_length=32)
    """One entry for each robot of the spec, with the name of its rigid body."""

    @property
    def address(self) -> str:
        """The host name of the computer that streams the poses, for display."""
        return self.hostname

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the location and a message for each mismatch with the robots of the spec."""
        yield from mismatches(self.robots, setup.names, ("body",))

    def bounds(self) -> dict[str, str]:
        """Describe the connection for display.

        Returns:
            One entry: "cameras" maps to the system and the hostname, such as "vicon at 10.0.0.5".
        """
        return {"cameras": f"{self.system} at {self.hostname}"}

    def heading_offset(self, name: str) -> float:
        """Return the angle added to the heading of a robot's rigid body [rad]."""
        return entry(self.robots, name).heading_offset
