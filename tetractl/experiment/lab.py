"""The lab's part of a spec: cameras, radio, robots, and what a run must not exceed.

Lengths whose name ends in `_mm` are millimetres, whatever the spec's length unit; times are
seconds.
"""

from typing import Annotated, Literal

from pydantic import Field

from tetractl.experiment.base import Finite, Model, Name, NonNegative, Point, Positive

Ipv4 = Annotated[
    str, Field(pattern=r"^(25[0-5]|2[0-4]\d|1?\d?\d)(\.(25[0-5]|2[0-4]\d|1?\d?\d)){3}$")
]
Port = Annotated[int, Field(ge=1, le=65_535)]


class Mocap(Model):
    """The camera system: an OptiTrack Motive server that speaks NatNet."""

    server: Ipv4
    """The server's address: IPv4, such as 192.168.1.10."""
    interface: Ipv4 = "0.0.0.0"
    """Address of this computer's network card that reaches the cameras: IPv4; 0.0.0.0 lets the
    system choose."""
    transport: Literal["multicast", "unicast"] = "multicast"
    """How the server streams; as set in Motive."""
    command_port: Port = 1510
    """The server's port for commands."""
    data_port: Port = 1511
    """Port of the multicast stream; unused in unicast."""
    group: Ipv4 = "239.255.42.99"
    """Address of the multicast stream: IPv4."""
    version: str | None = Field(default=None, pattern=r"^[2-4]\.\d{1,2}$")
    """Protocol version to ask for: major.minor, such as 4.1; the server's own by default, and
    always so in multicast."""
    up_axis: Literal["auto", "y", "z"] = "auto"
    """The axis that points up; `auto` asks the server."""
    origin: Point = (0.0, 0.0)
    """Where the cameras' origin lies in the spec's coordinates [length unit]."""
    rotation: Finite = 0.0
    """Turn from the spec's x axis to the cameras' [rad]."""


class Radio(Model):
    """The XBee module on a serial port."""

    port: str = Field(min_length=1, max_length=500)
    """The serial port, such as /dev/ttyUSB0."""
    baud: Literal[9600, 19200, 38400, 57600, 115200] = 57600
    """Bits a second on the port."""
    mode: Literal["api2", "api1", "transparent"] = "api2"
    """`api2`: escaped API frames (AP=2); `api1`: plain API frames (AP=1); `transparent`: bytes as
    they are."""
    rate: float = Field(default=40.0, ge=20, le=120, allow_inf_nan=False)
    """Wheel commands a second [Hz]."""


class Broadcast(Model):
    """One frame steers all robots, which run the mbed firmware: they stop by themselves after
    250 ms of silence."""

    type: Literal["broadcast"]


class Slave(Model):
    """One message a robot, which runs the 3pi's serial-slave program. It has no watchdog: a robot
    that loses the radio drives on."""

    type: Literal["slave"]
    accept_no_watchdog: Literal[True]
    """Must be true: somebody stands by to switch the robots off."""
    limit: int = Field(default=25, ge=1, le=40)
    """Greatest wheel count ever sent, of 127."""


Protocol = Annotated[Broadcast | Slave, Field(discriminator="type")]


class LabWheel(Model):
    """One wheel: its speed is gain times the counts beyond the dead zone."""

    gain_mm: float = Field(default=1000 / 127, gt=0, le=100, allow_inf_nan=False)
    """Speed gained a count [mm/s]."""
    dead_zone: int = Field(default=0, ge=0, le=60)
    """Counts that do not move the wheel yet."""
    invert: bool = False
    """The motor turns backward on positive counts."""


class LabRobot(Model):
    """What a robot is to the cameras and to the radio."""

    name: Name
    """Name of a robot of the spec."""
    body: str | int
    """Its rigid body in the camera system: name or id."""
    heading_offset: Finite = 0.0
    """Added to the rigid body's heading [rad]."""
    index: int | None = Field(default=None, ge=0, le=31)
    """Its number in broadcasts, as its firmware was built; its place in this list by default."""
    address: int | None = Field(default=None, ge=0, le=0xFFFD)
    """16-bit radio address (MY) of its module; needed for `slave`."""
    radius_mm: float | None = Field(default=None, gt=0, le=1000, allow_inf_nan=False)
    """Distance r from a wheel to its centre [mm]; `wheels.radius` by default."""
    left: LabWheel = LabWheel()
    """The left wheel."""
    right: LabWheel = LabWheel()
    """The right wheel."""
    swap: bool = False
    """The left wheel hangs on the motor meant for the right."""
    limit: int = Field(default=127, ge=1, le=127)
    """Greatest wheel count ever sent to it."""


class Limits(Model):
    """What ends a run, and what it waits for. The defaults are those of the fault table."""

    connect: Positive = 2.0
    """How long the camera server may take to answer, and then to stream [s]."""
    stale: Positive = 0.1
    """All robots stop when no new frame came for this long [s]."""
    stream_lost: Positive = 0.5
    """The run aborts when no new frame came for this long [s]."""
    untracked_stop: Positive = 0.05
    """A robot stops when it was not tracked for this long [s]."""
    untracked_abort: Positive = 0.3
    """The run aborts when a robot was not tracked for this long [s]."""
    jump_mm: NonNegative = 30.0
    """A pose further from the last than the robot can drive plus this is not believed [mm]."""
    bad_datagrams: int = Field(default=20, ge=1, le=100_000)
    """The run aborts on more damaged datagrams than this within a second."""
    edge_mm: NonNegative = 0.0
    """Robots stay this far inside the arena [mm]."""
    separation_mm: NonNegative = 110.0
    """Least distance between the centres of two robots [mm]; 0 does not look."""
    reaction: NonNegative = 0.15
    """From seeing an edge, or another robot, to standing still [s]: how far ahead the guard
    looks."""
    disobedience: Positive = 1.0
    """Warns of a robot that has not moved as told for this long [s]."""
    late_steps: int = Field(default=5, ge=1, le=100_000)
    """The run aborts after this many control steps in a row that missed their deadline."""
    battery_refuse: NonNegative = 4.0
    """A robot below this voltage does not start [V]."""
    battery_warn: NonNegative = 4.4
    """A robot below this voltage is warned of [V]."""
    latency: Positive = 0.1
    """A run does not start when frames are older than this on arrival [s]."""
    start_mm: Positive = 50.0
    """How near its start a robot must stand [mm]."""
    start_heading: Positive = 0.3
    """How near its start heading a robot must stand [rad]."""
    placing: NonNegative = 0.0
    """How long to wait for robots to be put on their starts [s]; with a terminal, as long as it
    takes."""
    standstill: Positive = 2.0
    """How long robots may take to stand still after a stop [s]."""
    standstill_mm: Positive = 10.0
    """Slower than this is standing still [mm/s]."""


class LabSpec(Model):
    """Real robots in a real arena: cameras in, radio out."""

    type: Literal["lab"] = "lab"
    mocap: Mocap
    """The camera system."""
    radio: Radio
    """The radio at this computer."""
    protocol: Protocol = Broadcast(type="broadcast")
    """How the robots are spoken to."""
    robots: tuple[LabRobot, ...] = Field(min_length=1, max_length=32)
    """Every robot of the spec, once."""
    limits: Limits = Limits()
    """What ends a run, and what it waits for."""
    calibration: str | None = Field(default=None, min_length=1, max_length=500)
    """A file written by `tetractl lab calibrate`, relative to the spec; it replaces wheels, radius
    and heading offset of the robots it names."""

    def index(self, robot: LabRobot) -> int:
        """Return a robot's number in broadcasts."""
        return self.robots.index(robot) if robot.index is None else robot.index
