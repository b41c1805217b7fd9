"""The emulated camera of type `optitrack`: its settings and faults, and a server of rigid
bodies.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from random import Random
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.emulate.faults import Fault, Share, Undo, Visible, fault, setting, settings
from tetractl.emulate.loop import Loop
from tetractl.emulate.optitrack.motive import Motive, OptitrackSettings, ServerClock, TrueBody
from tetractl.emulate.optitrack.tracked_body import TrackedBody, View, halved, nowhere, rolled
from tetractl.emulate.sides import Body, Facts, Stage
from tetractl.experiment.base import Finite, Model, Name, Point, Positive
from tetractl.experiment.lab_section import entry
from tetractl.lab.cameras.optitrack.natnet import RigidBody, Version
from tetractl.lab.cameras.optitrack.pose import UpAxis
from tetractl.lab.cameras.optitrack.section import OptitrackSection, VersionText


def _body(device: Any, fault: Any) -> TrackedBody:
    return device.tracked_body(fault.robot)


def _clock(device: Any, fault: Any) -> ServerClock:
    return device.motive.clock


def _trouble(
    name: str, about: str, visible: Visible, fields: Mapping[str, Any] = {}, **values: object
) -> type[Fault]:
    """Return a kind of fault of the server, which sets attributes of its `Trouble`."""
    return fault(name, about, settings(lambda d, f: d.motive.trouble, **values), visible, **fields)


def _of_body(
    name: str, about: str, fields: Mapping[str, Any] = {}, **values: object
) -> type[Fault]:
    """Return a kind of fault of one robot's rigid body, which sets attributes of the body."""
    return fault(name, about, settings(_body, **values), EXPOSED, robot=Name, **fields)


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
Frames = Annotated[int, Field(ge=1, le=1_000_000)]
Axes = Literal["floor", "robot"]
FAULTS = (
    _trouble("no_server", "The server sends nothing.", SENT, silent=True),
    _trouble("no_frames", "No frames are sent.", SENT, no_frames=True),
    _trouble("freeze", "The same frame is sent repeatedly.", SENT, frozen=True),
    _trouble(
        "counter_back",
        "The frame number goes back by this number.",
        EXPOSED,
        {"frames": Frames},
        counter=attrgetter("frames"),
    ),
    _trouble("edit_mode", "Motive is in edit mode.", EXPOSED, edit_mode=True),
    _trouble(
        "bad_datagrams",
        "A fraction of the frames is damaged.",
        SENT,
        {"share": Share},
        damaged=attrgetter("share"),
    ),
    _trouble(
        "other_version",
        "Frames have another protocol version than the server reports.",
        SENT,
        {"version": VersionText},
        version=lambda f: Version.of(f.version),
    ),
    _trouble(
        "outdated",
        "This number of frames has exposure times that are too early by this time [s].",
        EXPOSED,
        {"by": Positive, "frames": (Frames, 1)},
        outdated=attrgetter("frames"),
        outdated_s=attrgetter("by"),
    ),
    _of_body("untracked", "A body is not tracked; its last pose is repeated.", tracked=False),
    _of_body(
        "jump",
        "A body's pose jumps by this distance [mm].",
        {"by": Point},
        shift=lambda f: complex(*f.by),
    ),
    _of_body(
        "ghost",
        "A body's pose moves away from its robot: by this distance [mm] and angle [rad] in each "
        "frame, along the spec's axes or along and left of the robot's heading.",
        {"by": Point, "axes": (Axes, "floor"), "turn": (Finite, 0.0)},
        step=lambda f: complex(*f.by),
        own=lambda f: f.axes == "robot",
        turn=attrgetter("turn"),
        shift=0j,
        turned=0.0,
    ),
    _of_body(
        "lifted",
        "A body is seen at this height above the floor [mm].",
        {"height": Finite},
        height=attrgetter("height"),
    ),
    _of_body(
        "tipped",
        "A body is seen rolled about its own x axis by this angle [rad].",
        {"angle": Finite},
        change=lambda f: rolled(f.angle),
    ),
    _of_body("nan", "A body's position is not a number.", change=lambda f: nowhere),
    _of_body(
        "bad_quaternion", "A body's quaternion does not have norm 1.", change=lambda f: halved
    ),
    fault(
        "repeat",
        "The pose of a body, or of all bodies, is repeated in new frames.",
        _repeat,
        EXPOSED,
        robot=(Name | None, None),
    ),
    fault("swap", "Two bodies swap identities.", _swap, EXPOSED, robot=Name, other=Name),
    fault("twin_id", "A body has the id of another body.", _twin, EXPOSED, robot=Name, other=Name),
    fault("clock_jump", "The server's clock is set forward by a time [s].", _set_clock, by=Finite),
    fault(
        "clock_rate",
        "The server's clock advances by this time [s] each second.",
        _run_clock,
        rate=Positive,
    ),
)


class EmulatedOptitrack:
    """An emulated Motive server, and the rigid bodies on the robots."""

    Settings: ClassVar[type[Model]] = OptitrackSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS

    def __init__(self, stage: Stage, settings: OptitrackSettings, bodies: Sequence[Body]) -> None:
        section = stage.lab.camera
        assert isinstance(section, OptitrackSection), "the camera's section has the type optitrack"
        self.swapped: set[int] = set()  # the indices of two bodies that exchange their ids
        self.tracked = _tracked(section, settings, bodies, Random(stage.options.seed))
        up = UpAxis.Z if section.up_axis == "z" else UpAxis.Y
        x, y = section.origin
        self.view = View(up, (x * stage.mm, y * stage.mm), section.rotation)
        names = [(body.body_name, body.id) for body in self.tracked]
        self.motive = Motive(stage, section, settings, up, names, self._expose)
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

    def _expose(self) -> tuple[RigidBody, ...]:
        """Return the bodies as the cameras report them now."""
        bodies = [each.expose(self.view) for each in self.tracked]
        if len(self.swapped) == 2:
            i, j = self.swapped
            one, other = bodies[i], bodies[j]
            bodies[i], bodies[j] = replace(other, id=one.id), replace(one, id=other.id)
        streamed = {body.id for body in self.tracked if body.streamed}
        return tuple(body for body in bodies if body.id in streamed)


def _tracked(
    section: OptitrackSection, settings: OptitrackSettings, bodies: Sequence[Body], random: Random
) -> list[TrackedBody]:
    noise = settings.noise_mm, settings.noise_rad
    truths = {robot.name: robot for robot in settings.robots}
    taken = {robot.body for robot in section.robots if isinstance(robot.body, int)}
    free = iter(sorted(set(range(1, 1000)) - taken))
    found: list[TrackedBody] = []
    for body in bodies:
        robot = entry(section.robots, body.name)
        number = robot.body if isinstance(robot.body, int) else next(free)
        truth = truths.get(body.name, TrueBody(name=body.name))
        named = truth.body or (robot.body if isinstance(robot.body, str) else robot.name)
        offset = truth.heading_offset
        offset = robot.heading_offset if offset is None else offset
        streamed = truth.streamed
        found.append(TrackedBody(body, number, named, offset, noise, random, streamed))
    return found
