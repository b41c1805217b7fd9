"""The emulated camera of type `optitrack`: its settings and faults, and a server of rigid
bodies.
"""

from collections.abc import Sequence
from operator import attrgetter
from random import Random
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.core.errors import SpecError
from tetractl.emulate.faults import Fault, Share, Undo, Visible, fault, setting, settings
from tetractl.emulate.loop import Loop
from tetractl.emulate.optitrack.motive import Motive
from tetractl.emulate.optitrack.natnet_server import ServerClock, Streaming, Trouble
from tetractl.emulate.optitrack.tracked_body import TrackedBody, View, expose
from tetractl.emulate.sides import Body, Facts, Stage
from tetractl.experiment.base import Finite, Model, Name, NonNegative, Point, Positive
from tetractl.lab.cameras.optitrack.natnet_messages import BodyName, Version
from tetractl.lab.cameras.optitrack.pose import UpAxis
from tetractl.lab.cameras.optitrack.section import Ipv4, OptitrackSection, VersionText


class TrueBody(Model):
    """True properties of a robot's rigid body that differ from the spec."""

    name: Name
    """Name of a robot of the spec."""
    heading_offset: Finite | None = None
    """Heading of the robot minus heading of its rigid body [rad]."""
    body: str | None = Field(default=None, min_length=1, max_length=64)
    """Name of the body in Motive."""
    streamed: bool = True
    """Whether the body is in the frames; it is always in the list of names."""


class OptitrackSettings(Model):
    """Properties of the cameras that differ from the spec."""

    version: VersionText = "4.1"
    """The camera server's protocol version, 2.5 or later; frames of 2.5 have the layout of 2.6.
    Versions above 4.3 have the layout of 4.3 with longer descriptions of rigid bodies."""
    keeps_version: bool = False
    """Whether the server streams in its own version to clients that request another version."""
    frames_from: Ipv4 | None = None
    """Address from which frames are sent, such as a second network card; by default the server's.
    """
    answers_models: bool = True
    """Whether the server reports the names of its rigid bodies."""
    models_changed: bool = False
    """Whether every frame reports that the rigid bodies have changed."""
    rate: float = Field(default=120.0, ge=1, le=500)
    """Camera frames per second [Hz]."""
    latency: float = Field(default=0.0054, ge=0, le=1)
    """Mean time from exposure to transmission [s]."""
    unit_mm: Positive = 1000.0
    """Unit of length that the server reports [mm]; positions are always in metres."""
    noise_mm: NonNegative = 0.0
    """Standard deviation of a body's position along each axis of the floor [mm]."""
    noise_rad: NonNegative = 0.0
    """Standard deviation of a body's heading [rad]."""
    up: Literal["y", "z"] | None = None
    """The cameras' vertical axis; by default the spec's, or y if the spec has none."""
    knows_up_axis: bool = True
    """Whether the server answers `UpAxis`."""
    robots: tuple[TrueBody, ...] = ()
    """Robots whose rigid bodies have another name or heading offset than in the spec, or are not
    streamed."""


def _trouble(device: Any, fault: Any) -> Trouble:
    return device.motive.trouble


def _body(device: Any, fault: Any) -> TrackedBody:
    return device.tracked_body(fault.robot)


def _clock(device: Any, fault: Any) -> ServerClock:
    return device.motive.server.clock


def _walk(fault: Any, device: Any) -> Undo:
    own, start = fault.axes == "robot", (0.0, 0.0)
    body = _body(device, fault)
    return setting(body, step=fault.by, shift=start, own=own, turn=fault.turn, turned=0.0)


def _repeat(fault: Any, device: Any) -> Undo:
    chosen = [b for b in device.tracked if fault.robot in (None, b.robot.name)]
    undos = [setting(body, repeats=True) for body in chosen]

    def undo() -> None:
        for each in undos:
            each()

    return undo


def _swap(fault: Any, device: Any) -> Undo:
    return setting(device, swapped={device.place_of(fault.robot), device.place_of(fault.other)})


def _set_clock(fault: Any, device: Any) -> Undo:
    clock = _clock(device, fault)
    return setting(clock, ahead_ns=clock.ahead_ns + round(fault.by * SECOND))


def _run_clock(fault: Any, device: Any) -> Undo:
    return setting(_clock(device, fault), rate=fault.rate, since_ns=device.motive.now_ns)


def _twin(fault: Any, device: Any) -> Undo:
    return setting(_body(device, fault), id=device.tracked_body(fault.other).id)


SENT, EXPOSED = Visible.SENT, Visible.EXPOSED
Frames = Annotated[int, Field(ge=1, le=1_000_000)]
Axes = Literal["floor", "robot"]
FAULTS = (
    fault("no_server", "The server sends nothing.", settings(_trouble, silent=True), SENT),
    fault("no_frames", "No frames are sent.", settings(_trouble, no_frames=True), SENT),
    fault("freeze", "The same frame is sent repeatedly.", settings(_trouble, frozen=True), SENT),
    fault(
        "counter_back",
        "The frame number goes back by this number.",
        settings(_trouble, counter=attrgetter("frames")),
        EXPOSED,
        frames=Frames,
    ),
    fault("edit_mode", "Motive is in edit mode.", settings(_trouble, edit_mode=True), EXPOSED),
    fault(
        "bad_datagrams",
        "A fraction of the frames is damaged.",
        settings(_trouble, damaged=attrgetter("share")),
        SENT,
        share=Share,
    ),
    fault(
        "other_version",
        "Frames have another protocol version than the server reports.",
        settings(_trouble, version=lambda f: Version.of(f.version)),
        SENT,
        version=VersionText,
    ),
    fault(
        "untracked",
        "A body is not tracked; its last pose is repeated.",
        settings(_body, tracked=False),
        EXPOSED,
        robot=Name,
    ),
    fault(
        "jump",
        "A body's pose jumps by this distance [mm].",
        settings(_body, shift=attrgetter("by")),
        EXPOSED,
        robot=Name,
        by=Point,
    ),
    fault(
        "ghost",
        "A body's pose moves away from its robot: by this distance [mm] and angle [rad] in each "
        "frame, along the spec's axes or along and left of the robot's heading.",
        _walk,
        EXPOSED,
        robot=Name,
        by=Point,
        axes=(Axes, "floor"),
        turn=(Finite, 0.0),
    ),
    fault(
        "repeat",
        "The pose of a body, or of all bodies, is repeated in new frames.",
        _repeat,
        EXPOSED,
        robot=(Name | None, None),
    ),
    fault(
        "lifted",
        "A body is seen at this height above the floor [mm].",
        settings(_body, height=attrgetter("height")),
        EXPOSED,
        robot=Name,
        height=Finite,
    ),
    fault(
        "tipped",
        "A body is seen rolled about its own x axis by this angle [rad].",
        settings(_body, roll=attrgetter("angle")),
        EXPOSED,
        robot=Name,
        angle=Finite,
    ),
    fault(
        "outdated",
        "This number of frames has exposure times that are too early by this time [s].",
        settings(_trouble, outdated=attrgetter("frames"), outdated_s=attrgetter("by")),
        EXPOSED,
        by=Positive,
        frames=(Frames, 1),
    ),
    fault("swap", "Two bodies swap identities.", _swap, EXPOSED, robot=Name, other=Name),
    fault(
        "nan", "A body's position is not a number.", settings(_body, nan=True), EXPOSED, robot=Name
    ),
    fault(
        "bad_quaternion",
        "A body's quaternion does not have norm 1.",
        settings(_body, norm=0.5),
        EXPOSED,
        robot=Name,
    ),
    fault("clock_jump", "The server's clock is set forward by a time [s].", _set_clock, by=Finite),
    fault(
        "clock_rate",
        "The server's clock advances by this time [s] each second.",
        _run_clock,
        rate=Positive,
    ),
    fault("twin_id", "A body has the id of another body.", _twin, EXPOSED, robot=Name, other=Name),
)


class EmulatedOptitrack:
    """An emulated Motive server, and the rigid bodies on the robots."""

    Settings: ClassVar[type[Model]] = OptitrackSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS

    def __init__(self, stage: Stage, settings: OptitrackSettings, bodies: Sequence[Body]) -> None:
        section = stage.lab.camera
        assert isinstance(section, OptitrackSection), "the camera's section has the type optitrack"
        self.swapped: set[int] = set()
        hidden = {robot.name for robot in settings.robots if not robot.streamed}
        self.tracked = _tracked(section, settings, bodies, Random(stage.options.seed))
        self.hidden = {body.id for body in self.tracked if body.robot.name in hidden}
        self.view = _view(stage, section, settings)
        self.motive = Motive(
            stage.timeline,
            _streaming(stage, section, settings, self.view.up),
            [BodyName(body.body_name, body.id) for body in self.tracked],
            lambda: expose(self.tracked, self.view, self.swapped, self.hidden),
            stage.exposed,
            stage.sent,
            stage.client,
            stage.options.seed,
            stage.wires.bound,
        )
        self.join = stage.wires.make_socket

    def open(self, loop: Loop) -> Facts:
        """Open the UDP ports; return their addresses."""
        loop.watch(self.motive.open(), lambda: self.motive.readable(loop.catch_up))
        streaming = self.motive.streaming
        return {
            "camera": f"{streaming.address}:{self.motive.command_port} ({streaming.transport})",
            "address": streaming.address,
            "command_port": self.motive.command_port,
            "data_port": self.motive.data_port,
            "transport": streaming.transport,
        }

    def close(self) -> Facts:
        """Close the UDP ports; return counts to be recorded."""
        self.motive.close()
        counts = self.motive.counts
        return {"frames": counts.frames, "refused": counts.refused, "timed_out": counts.timed_out}

    def hide(self, hidden: bool) -> None:
        """If `hidden`, track no body; otherwise track all bodies again."""
        for body in self.tracked:
            body.tracked = not hidden

    def tracked_body(self, name: str) -> TrackedBody:
        """Return the rigid body of the robot with this name."""
        return self.tracked[self.place_of(name)]

    def place_of(self, name: str) -> int:
        """Return the index of the robot with this name."""
        return next(i for i, body in enumerate(self.tracked) if body.robot.name == name)


def _tracked(
    section: OptitrackSection, settings: OptitrackSettings, bodies: Sequence[Body], random: Random
) -> list[TrackedBody]:
    noise = settings.noise_mm, settings.noise_rad
    truths = {robot.name: robot for robot in settings.robots}
    taken = {robot.body for robot in section.robots if isinstance(robot.body, int)}
    free = iter(sorted(set(range(1, 1000)) - taken))
    found: list[TrackedBody] = []
    for body in bodies:
        robot = section.robot(body.name)
        number = robot.body if isinstance(robot.body, int) else next(free)
        truth = truths.get(body.name, TrueBody(name=body.name))
        named = truth.body or (robot.body if isinstance(robot.body, str) else robot.name)
        offset = truth.heading_offset
        offset = robot.heading_offset if offset is None else offset
        found.append(TrackedBody(body, number, named, offset, noise, random))
    return found


def _view(stage: Stage, section: OptitrackSection, settings: OptitrackSettings) -> View:
    """Return the cameras' axes; the vertical axis is the settings', else the spec's, else y."""
    up = UpAxis.Z if (settings.up or section.up_axis) == "z" else UpAxis.Y
    x, y = section.origin
    return View(up, (x * stage.mm, y * stage.mm), section.rotation)


def _streaming(
    stage: Stage, section: OptitrackSection, settings: OptitrackSettings, up: UpAxis
) -> Streaming:
    options = stage.options
    return Streaming(
        options.address or section.server,
        section.command_port if options.command_port is None else options.command_port,
        section.data_port if options.data_port is None else options.data_port,
        section.transport,
        section.group,
        _version(settings.version),
        settings.rate,
        settings.latency,
        up=up,
        knows_up_axis=settings.knows_up_axis,
        frames_from=settings.frames_from,
        keeps_version=settings.keeps_version,
        answers_models=settings.answers_models,
        models_changed=settings.models_changed,
        unit_mm=settings.unit_mm,
    )


def _version(text: str) -> Version:
    version = Version.of(text)
    if version < (2, 5):
        raise SpecError(f"cannot emulate NatNet {version}", hint="use version 2.5 or later")
    return version
