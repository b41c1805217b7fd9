"""The emulated camera of type `optitrack`: its settings and faults, and a server of rigid
bodies.
"""

from collections.abc import Mapping, Sequence
from operator import attrgetter
from random import Random
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.emulate.faults import Fault, Share, Undo, Visible, fault, setting, settings
from tetractl.emulate.loop import Loop
from tetractl.emulate.optitrack.motive import (
    Motive,
    OptitrackSettings,
    ServerClock,
    Trouble,
    TrueBody,
)
from tetractl.emulate.optitrack.tracked_body import TrackedBody, View, expose
from tetractl.emulate.sides import Body, Facts, Stage
from tetractl.experiment.base import Finite, Model, Name, Point, Positive
from tetractl.lab.cameras.optitrack.natnet_messages import BodyName, Version
from tetractl.lab.cameras.optitrack.pose import UpAxis
from tetractl.lab.cameras.optitrack.section import OptitrackSection, VersionText


def _trouble(device: Any, fault: Any) -> Trouble:
    return device.motive.trouble


def _body(device: Any, fault: Any) -> TrackedBody:
    return device.tracked_body(fault.robot)


def _clock(device: Any, fault: Any) -> ServerClock:
    return device.motive.clock


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
    return setting(_clock(device, fault), rate=fault.rate, since_ns=device.motive.timeline.now_ns)


def _twin(fault: Any, device: Any) -> Undo:
    return setting(_body(device, fault), id=device.tracked_body(fault.other).id)


SENT, EXPOSED = Visible.SENT, Visible.EXPOSED


def _body_fault(name: str, about: str, fields: Mapping[str, Any] = {}, **values: object) -> Any:
    """Return a kind of fault of one robot's rigid body, which sets attributes of the body."""
    return fault(name, about, settings(_body, **values), EXPOSED, robot=Name, **fields)


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
    _body_fault("untracked", "A body is not tracked; its last pose is repeated.", tracked=False),
    _body_fault(
        "jump",
        "A body's pose jumps by this distance [mm].",
        shift=attrgetter("by"),
        fields={"by": Point},
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
    _body_fault(
        "lifted",
        "A body is seen at this height above the floor [mm].",
        height=attrgetter("height"),
        fields={"height": Finite},
    ),
    _body_fault(
        "tipped",
        "A body is seen rolled about its own x axis by this angle [rad].",
        roll=attrgetter("angle"),
        fields={"angle": Finite},
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
    _body_fault("nan", "A body's position is not a number.", nan=True),
    _body_fault("bad_quaternion", "A body's quaternion does not have norm 1.", norm=0.5),
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
            stage,
            section,
            settings,
            self.view.up,
            [BodyName(body.body_name, body.id) for body in self.tracked],
            lambda: expose(self.tracked, self.view, self.swapped, self.hidden),
        )
        self.join = stage.wires.make_socket

    def open(self, loop: Loop) -> Facts:
        """Open the UDP ports; return their addresses."""
        motive, transport = self.motive, self.motive.section.transport
        loop.watch(motive.open(), lambda: motive.readable(loop.catch_up))
        return {
            "camera": f"{motive.address}:{motive.command_port} ({transport})",
            "address": motive.address,
            "command_port": motive.command_port,
            "data_port": motive.data_port,
            "transport": transport,
        }

    def close(self) -> Facts:
        """Close the UDP ports; return counts to be recorded."""
        motive = self.motive
        motive.close()
        return {"frames": motive.frames, "refused": motive.refused, "timed_out": motive.timed_out}

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
