"""A script for the emulated lab: how it differs from the spec, which faults happen when, and what
is expected of whoever drives it."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from tetractl.experiment.base import Finite, Model, Name, NonNegative, Point, Positive
from tetractl.experiment.lab import LabWheel
from tetractl.experiment.load import frozen
from tetractl.experiment.yaml.document import Document, parse_document, read_text
from tetractl.experiment.yaml.problems import InvalidSpecError, Problem

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=-127, le=127)]

FAULTS: dict[str, tuple[str, ...]] = {
    "no_server": (),
    "no_frames": (),
    "freeze": (),
    "counter_back": ("frames",),
    "edit_mode": (),
    "bad_datagrams": ("share",),
    "other_version": ("version",),
    "untracked": ("robot",),
    "jump": ("robot", "by"),
    "swap": ("robot", "other"),
    "nan": ("robot",),
    "bad_quaternion": ("robot",),
    "veer": ("robot", "counts"),
    "wheel_stuck": ("robot", "wheel"),
    "unplug": (),
    "stuck_port": (),
    "loss": ("share",),
    "off": ("robot",),
    "wrong_id": ("robot", "id"),
    "low_battery": ("robot", "millivolts"),
    "mark": ("name",),
}
"""Each fault and the keys it needs; it takes no others but `at`, `since` and `for`."""


class Fault(Model):
    """One thing that goes wrong."""

    fault: str
    """What: a key of `FAULTS`."""
    at: NonNegative = 0.0
    """When, after `since` [s]."""
    since: Literal["start", "client", "run"] = "run"
    """`start` of the emulation, the first `client` of the cameras, or the first wheel command of a
    `run`."""
    duration: Positive | None = Field(default=None, alias="for")
    """How long [s]; for good by default."""
    robot: Name | None = None
    """The robot it happens to."""
    other: Name | None = None
    """The robot whose identity it takes."""
    by: Point | None = None
    """How far its pose jumps [mm]."""
    counts: tuple[Count, Count] | None = None
    """What its motors get instead of any count but 0, as sent."""
    wheel: Literal["left", "right", "both"] | None = None
    """Which wheel does not turn any more."""
    share: Share | None = None
    """How many of all, 0 to 1."""
    frames: int | None = Field(default=None, ge=1, le=1_000_000)
    """How far the frame counter goes back."""
    id: int | None = Field(default=None, ge=0, le=31)
    """The number in broadcasts that its firmware was built with."""
    millivolts: int | None = Field(default=None, ge=0, le=9000)
    """The battery's voltage."""
    version: str | None = Field(default=None, pattern=r"^[2-4]\.\d{1,2}$")
    """Protocol version of the frames, whatever the server told."""
    name: Name | None = None
    """What the mark is called."""

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Self:
        if self.fault not in FAULTS:
            raise ValueError(f"fault must be one of {', '.join(FAULTS)}")
        every = {key for keys in FAULTS.values() for key in keys}
        given = {key for key in every if getattr(self, key) is not None}
        needed = set(FAULTS[self.fault])
        if missing := needed - given:
            raise ValueError(f"{self.fault} needs {', '.join(sorted(missing))}")
        if surplus := given - needed:
            raise ValueError(f"{self.fault} does not take {', '.join(sorted(surplus))}")
        return self


class TrueRobot(Model):
    """A robot as it truly is, where that differs from what the spec says of it."""

    name: Name
    """Name of a robot of the spec."""
    start: Point | None = None
    """Where it stands at first [length unit]."""
    heading: Finite | None = None
    """How it stands at first [rad]."""
    left: LabWheel | None = None
    """Its left wheel."""
    right: LabWheel | None = None
    """Its right wheel."""
    swap: bool | None = None
    """Whether its left wheel hangs on the motor meant for the right."""
    radius_mm: Positive | None = None
    """Distance r from a wheel to its centre [mm]."""
    heading_offset: Finite | None = None
    """Heading of the robot less that of its rigid body [rad]."""
    lag: Annotated[float, Field(gt=0, le=1)] = 0.04
    """Time constant of its wheels [s]."""
    battery_mv: int = Field(default=5100, ge=0, le=9000)
    """Its battery's voltage without load."""


class Emulation(Model):
    """How the emulated lab differs from what the spec says."""

    version: str = Field(default="4.1", pattern=r"^[2-4]\.\d{1,2}$")
    """The camera server's protocol version, 2.6 to 4.3."""
    rate: float = Field(default=120.0, ge=1, le=500)
    """Camera frames a second [Hz]."""
    latency: float = Field(default=0.0054, ge=0, le=1)
    """From exposure to transmission [s]."""
    up: Literal["y", "z"] | None = None
    """The cameras' vertical axis; the spec's, or y."""
    knows_up_axis: bool = True
    """Whether the server answers `UpAxis`."""
    firmware: Literal["802.15.4", "zigbee"] = "802.15.4"
    """What the radio's module runs."""
    baud: Literal[9600, 19200, 38400, 57600, 115200] | None = None
    """The module's speed; the spec's by default."""
    mode: Literal["api2", "api1", "transparent"] | None = None
    """The module's mode; the spec's by default."""
    loss: Share = 0.0
    """Probability that a robot does not hear a transmission."""
    robots: tuple[TrueRobot, ...] = ()
    """The robots that are not as the spec says."""


class Runner(Model):
    """What a test does to whoever drives the lab."""

    sets: tuple[str, ...] = Field(default=(), alias="set")
    """`--set` settings that both sides get."""
    on_mark: dict[str, Literal["KILL", "STOP", "CONT", "INT", "TERM"]] = Field(default={})
    """Signals to send it when a `mark` of that name comes."""
    second: bool = False
    """A second runner is started on the same port at the mark `second`."""
    file_limit: int | None = Field(default=None, ge=1)
    """Greatest size of a file it may write [bytes], as if the disk were full."""
    trials: int = Field(default=1, ge=1, le=20)
    """Number of trials."""


class Expect(Model):
    """What is expected, machine-readable: the end-to-end test reads it."""

    outcome: Literal["done", "aborted", "refused", "interrupted", "killed"]
    """How the run ends; `refused` is before any wheel turns."""
    exit: int
    """The runner's exit code; less than 0 for the signal that killed it."""
    says: str = ""
    """A regular expression for what the runner says, in its output or its log."""
    tolerance: NonNegative | None = None
    """The fault's own tolerance [s]; the stop frame leaves within 0.1 s more."""
    robots: tuple[Name, ...] = ()
    """The robots that have to stop; all by default."""
    still: Positive | None = None
    """All robots stand still this long after the fault is first visible [s]."""
    inside: bool = False
    """No robot's centre ever leaves the arena."""
    apart_mm: Positive | None = None
    """Centres of robots never come nearer than this [mm]."""


class Script(Model):
    """A script, as read from YAML."""

    about: str = Field(min_length=1, max_length=500)
    """What it is for, one or two sentences."""
    row: str = Field(default="", max_length=200)
    """The kind of fault it stands for."""
    emulation: Emulation = Emulation()
    """How the emulated lab differs from what the spec says."""
    faults: tuple[Fault, ...] = Field(default=(), max_length=100)
    """What goes wrong, and when."""
    runner: Runner = Runner()
    """What a test does to whoever drives the lab."""
    expect: Expect | None = None
    """What a test expects."""


NOTHING = Script(about="nothing goes wrong")


def load_script(path: Path) -> Script:
    """Read a script; InvalidSpecError with a line for each problem."""
    return parse_script(read_text(path), str(path))


def parse_script(text: str, origin: str) -> Script:
    """Read the text of a script; `origin` is what problems call it."""
    document = parse_document(text, origin)
    try:
        script = Script.model_validate(frozen(document.data), strict=True)
    except ValidationError as error:
        problems = [_problem(details, document) for details in error.errors(include_url=False)]
        raise InvalidSpecError([*document.found, *problems]) from None
    if document.found:
        raise InvalidSpecError(document.found)
    return script


def _problem(details: ErrorDetails, document: Document) -> Problem:
    loc = tuple(details["loc"])
    message = details["msg"].removeprefix("Value error, ").replace("Input should", "should")
    if details["type"] == "extra_forbidden":
        place = document.keys.get(loc) or document.place(loc)
        return place.problem(loc, "unknown key")
    return document.place(loc).problem(loc, message[:1].lower() + message[1:])
