"""What can go wrong with the emulated OptiTrack cameras: the stream, one body, the server."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.emulate.faults import Fault, Undo, Visible, setting
from tetractl.experiment.base import Finite, Name, Point, Positive
from tetractl.lab.cameras.optitrack.messages import Version
from tetractl.lab.cameras.optitrack.section import VersionText

if TYPE_CHECKING:
    from tetractl.emulate.optitrack.side import EmulatedOptitrack

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class CameraFault(Fault):
    """A fault of the whole stream: `trouble` is what it sets of `Motive.trouble`."""

    trouble: ClassVar[dict[str, object]] = {}

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Set the trouble."""
        return setting(device.motive.trouble, **self.trouble)


class BodyFault(Fault):
    """A fault of one rigid body: `seen` is what it sets of the body."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    seen: ClassVar[dict[str, object]] = {}
    robot: Name
    """The robot it happens to."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Set what is seen of the body."""
        return setting(device.tracked_body(self.robot), **self.seen)


class NoServer(CameraFault):
    """Nothing answers, nothing is sent."""

    visible: ClassVar[Visible] = Visible.SENT
    trouble: ClassVar[dict[str, object]] = {"silent": True}
    fault: Literal["no_server"]


class NoFrames(CameraFault):
    """No frames are sent."""

    visible: ClassVar[Visible] = Visible.SENT
    trouble: ClassVar[dict[str, object]] = {"no_frames": True}
    fault: Literal["no_frames"]


class Freeze(CameraFault):
    """One frame is sent again and again."""

    visible: ClassVar[Visible] = Visible.SENT
    trouble: ClassVar[dict[str, object]] = {"frozen": True}
    fault: Literal["freeze"]


class EditMode(CameraFault):
    """Motive is in edit mode."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    trouble: ClassVar[dict[str, object]] = {"edit_mode": True}
    fault: Literal["edit_mode"]


class CounterBack(Fault):
    """The frame number goes back."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["counter_back"]
    frames: int = Field(ge=1, le=1_000_000)
    """How far."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Set the counter back."""
        return setting(device.motive.trouble, counter=self.frames)


class BadDatagrams(Fault):
    """A share of the frames is damaged."""

    visible: ClassVar[Visible] = Visible.SENT
    fault: Literal["bad_datagrams"]
    share: Share
    """How many of all, 0 to 1."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Damage datagrams from now on."""
        return setting(device.motive.trouble, damaged=self.share)


class OtherVersion(Fault):
    """Frames are of another version than the server says."""

    visible: ClassVar[Visible] = Visible.SENT
    fault: Literal["other_version"]
    version: VersionText
    """Protocol version of the frames."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Pack frames by the other version."""
        major, minor = self.version.split(".")
        return setting(device.motive.trouble, version=Version(int(major), int(minor)))


class Untracked(BodyFault):
    """A body is not tracked; its last pose is held."""

    seen: ClassVar[dict[str, object]] = {"tracked": False}
    fault: Literal["untracked"]


class NotANumber(BodyFault):
    """A body's position is no number."""

    seen: ClassVar[dict[str, object]] = {"nan": True}
    fault: Literal["nan"]


class BadQuaternion(BodyFault):
    """A body's quaternion is not of norm 1."""

    seen: ClassVar[dict[str, object]] = {"norm": 0.5}
    fault: Literal["bad_quaternion"]


class Jump(Fault):
    """A body's pose jumps."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["jump"]
    robot: Name
    """The robot it happens to."""
    by: Point
    """How far [mm]."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Shift what is seen of the body."""
        return setting(device.tracked_body(self.robot), shift=self.by)


class Ghost(Fault):
    """A body's pose walks away from its robot."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["ghost"]
    robot: Name
    """The robot it happens to."""
    by: Point
    """How far in each frame [mm]."""
    axes: Literal["floor", "robot"] = "floor"
    """Whether it walks along the spec's axes, or along the robot's heading and left of it."""
    turn: Finite = 0.0
    """How far it turns in each frame [rad]."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Let what is seen of the body walk."""
        body, own = device.tracked_body(self.robot), self.axes == "robot"
        return setting(body, step=self.by, shift=(0.0, 0.0), own=own, turn=self.turn, turned=0.0)


class Repeat(Fault):
    """What is seen of a body, or of all, is repeated in new frames."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["repeat"]
    robot: Name | None = None
    """The robot it happens to; all by default."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Let what is seen stay."""
        chosen = [b for b in device.tracked if self.robot in (None, b.robot.name)]
        for body in chosen:
            body.repeats = True

        def undo() -> None:
            for body in chosen:
                body.repeats = False

        return undo


class Lifted(Fault):
    """A body is seen at another height."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["lifted"]
    robot: Name
    """The robot it happens to."""
    height: Finite
    """Height above the floor [mm]."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Lift the body."""
        return setting(device.tracked_body(self.robot), height=self.height)


class Tipped(Fault):
    """A body is seen rolled about its own x axis."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["tipped"]
    robot: Name
    """The robot it happens to."""
    angle: Finite
    """How far [rad]."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Roll the body."""
        return setting(device.tracked_body(self.robot), roll=self.angle)


class Outdated(Fault):
    """Some frames are stamped with an older exposure than they have."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["outdated"]
    by: Positive
    """By how much [s]."""
    frames: int = Field(default=1, ge=1, le=1_000_000)
    """How many frames."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Stamp the next frames so."""
        return setting(device.motive.trouble, outdated=self.frames, outdated_s=self.by)


class Swap(Fault):
    """Two bodies swap identities."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["swap"]
    robot: Name
    """One robot."""
    other: Name
    """The other."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Swap the two."""
        return setting(device, swapped={device.place_of(self.robot), device.place_of(self.other)})


class ClockJump(Fault):
    """The camera server's clock is set."""

    fault: Literal["clock_jump"]
    by: Finite
    """By how much, forward where it is positive [s]."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Set the clock."""
        clock = device.motive.server.clock
        return setting(clock, ahead_ns=clock.ahead_ns + round(self.by * SECOND))


class ClockRate(Fault):
    """The camera server's clock runs fast or slow."""

    fault: Literal["clock_rate"]
    rate: Positive
    """How much it gains for each second."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Let the clock run so from now on."""
        clock = device.motive.server.clock
        return setting(clock, rate=self.rate, since_ns=device.motive.now_ns)


class TwinId(Fault):
    """A body has the id of another."""

    visible: ClassVar[Visible] = Visible.EXPOSED
    fault: Literal["twin_id"]
    robot: Name
    """The robot whose body has the other's id."""
    other: Name
    """The robot that the id belongs to."""

    def begin(self, device: "EmulatedOptitrack") -> Undo:
        """Give the body the id."""
        return setting(device.tracked_body(self.robot), id=device.tracked_body(self.other).id)


FAULTS: tuple[type[Fault], ...] = (
    NoServer,
    NoFrames,
    Freeze,
    CounterBack,
    EditMode,
    BadDatagrams,
    OtherVersion,
    Untracked,
    Jump,
    Ghost,
    Repeat,
    Lifted,
    Tipped,
    Outdated,
    Swap,
    NotANumber,
    BadQuaternion,
    ClockJump,
    ClockRate,
    TwinId,
)
