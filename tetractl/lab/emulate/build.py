"""From a spec and a script to the parts of an emulated lab."""

from collections.abc import Callable
from functools import partial

from tetractl.core.errors import SpecError
from tetractl.core.setup import METRES
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab import LabRobot, LabSpec, LabWheel
from tetractl.experiment.lab import Slave as SlaveSpec
from tetractl.lab.actuators.m3pi.command import Drivetrain, Wheel
from tetractl.lab.cameras.optitrack.messages import BodyName, Version
from tetractl.lab.cameras.optitrack.pose import UpAxis
from tetractl.lab.emulate.module import Settings
from tetractl.lab.emulate.robot import Battery, Firmware, Program, Robot, Slave
from tetractl.lab.emulate.script import Script, TrueRobot
from tetractl.lab.emulate.tracked_body import Sight, View

MODES = {"transparent": 0, "api1": 1, "api2": 2}
SERIES_1, SERIES_2 = (0x1744, 0x10EC), (0x1944, 0x21A7)  # HV, VR: 802.15.4, Zigbee


def version_of(text: str) -> Version:
    """Return a protocol version that can be emulated."""
    major, minor = text.split(".")
    version = Version(int(major), int(minor))
    if not version >= (2, 6) or not version.known:
        raise SpecError(f"cannot emulate NatNet {version}", hint="take one from 2.6 to 4.3")
    return version


def up_axis(lab: LabSpec, script: Script) -> UpAxis:
    """Return the axis that is up: the script's, the spec's, or Motive's own default, y."""
    name = script.emulation.up or lab.mocap.up_axis
    return UpAxis.Z if name == "z" else UpAxis.Y


def view(experiment: Experiment, lab: LabSpec, script: Script) -> View:
    """Return how the cameras' coordinates lie."""
    mm = METRES[experiment.units.length] * 1000
    x, y = lab.mocap.origin
    return View(up_axis(lab, script), (x * mm, y * mm), lab.mocap.rotation)


def radio_settings(lab: LabSpec, script: Script) -> Settings:
    """Return how the PC's module is set."""
    emulation = script.emulation
    hardware, firmware = SERIES_2 if emulation.firmware == "zigbee" else SERIES_1
    mode = MODES[emulation.mode or lab.radio.mode]
    return Settings(emulation.baud or lab.radio.baud, mode, hardware, firmware)


def addresses(lab: LabSpec) -> list[int]:
    """Return the robots' 16-bit radio addresses; the number in broadcasts plus 1 by default."""
    return [
        robot.address if robot.address is not None else lab.index(robot) + 1 for robot in lab.robots
    ]


def sights(experiment: Experiment, lab: LabSpec, script: Script) -> list[Sight]:
    """Return the robots, in the lab's order, each with its rigid body."""
    truths = {truth.name: truth for truth in script.emulation.robots}
    named = {robot.name for robot in experiment.robots}
    for name in [*truths, *(f.robot for f in script.faults), *(f.other for f in script.faults)]:
        if name is not None and name not in named:
            raise SpecError(f"the script's {name} is no robot of the spec")
    taken = {robot.body for robot in lab.robots if isinstance(robot.body, int)}
    free = iter(sorted(set(range(1, 1000)) - taken))
    found: list[Sight] = []
    for robot in lab.robots:
        truth = truths.get(robot.name) or TrueRobot(name=robot.name)
        number = robot.body if isinstance(robot.body, int) else next(free)
        body_name = robot.body if isinstance(robot.body, str) else robot.name
        offset = robot.heading_offset if truth.heading_offset is None else truth.heading_offset
        true_robot = _robot(experiment, lab, robot, truth)
        found.append(Sight(true_robot, number, body_name, offset))
    return found


def body_names(found: list[Sight]) -> list[BodyName]:
    """Return the rigid bodies as MODELDEF lists them."""
    return [BodyName(sight.body_name, sight.id) for sight in found]


def start_of(experiment: Experiment, script: Script, name: str) -> tuple[float, float, float]:
    """Return where a robot stands at first: x, y [mm], heading [rad]."""
    mm = METRES[experiment.units.length] * 1000
    wanted = next(robot for robot in experiment.robots if robot.name == name)
    truth = next((t for t in script.emulation.robots if t.name == name), None)
    x, y = wanted.start if truth is None or truth.start is None else truth.start
    heading = wanted.heading if truth is None or truth.heading is None else truth.heading
    return x * mm, y * mm, heading


def _robot(experiment: Experiment, lab: LabSpec, robot: LabRobot, truth: TrueRobot) -> Robot:
    mm = METRES[experiment.units.length] * 1000
    radius = truth.radius_mm or robot.radius_mm
    if radius is None:
        if experiment.wheels is None:
            raise SpecError("the spec has no wheels", hint="add 'wheels: {radius: ..}'")
        radius = experiment.wheels.radius * mm
    swap = robot.swap if truth.swap is None else truth.swap
    drivetrain = Drivetrain(
        _wheel(truth.left or robot.left), _wheel(truth.right or robot.right), swap
    )
    boot: Callable[[], Program] = (
        Slave if isinstance(lab.protocol, SlaveSpec) else partial(Firmware, lab.index(robot))
    )
    battery = Battery(float(truth.battery_mv))
    return Robot(
        robot.name, boot, drivetrain, radius, 0.0, 0.0, 0.0, lag_s=truth.lag, battery=battery
    )


def _wheel(wheel: LabWheel) -> Wheel:
    return Wheel(wheel.gain_mm, wheel.dead_zone, wheel.invert)
