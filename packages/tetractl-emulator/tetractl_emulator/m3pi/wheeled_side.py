"""Base classes of emulated actuators for robots with two wheels, and their common faults.

To emulate your own robots, derive from `OwnLines` if each robot receives lines at its own port.
Otherwise derive from `PortedSide` and create `radios`, or derive from `WheeledSide` and also create
`robots` and `wheels`.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from random import Random
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.core.clock import NEVER, SECOND
from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheel_commands import radii_mm, wheels_by_speed
from tetractl.spec.base import Finite, Model, Name, Point, Positive
from tetractl.spec.lab_section import STOP_GAP_NS, STOPS, LabSection, entry
from tetractl_emulator.fault_rows import (
    DEFAULT_COMMAND_HZ,
    LINK_REASONS,
    MOTION_REASONS,
    MOVED_REASONS,
    NO_REASON,
    PLACE_REASONS,
    RADIO_REASONS,
    WHEEL_SIDES,
    FaultRow,
    lost_fraction,
    one_minus,
    one_of,
    pair,
    scaled_vector,
    signed_value,
    value_between,
    whole_number,
)
from tetractl_emulator.faults import ActingFaults, Share, Undo, fault_kind, port_faults, switching
from tetractl_emulator.loop import Timeline
from tetractl_emulator.m3pi.robot import BATTERY_MV, EmulatedRobot, EmulatedRobots
from tetractl_emulator.m3pi.robot_radio import RobotRadio
from tetractl_emulator.port import PluggedDevices
from tetractl_emulator.sides import Stage

PUSH_NS = SECOND // 5  # how long a push takes
PUSH_PARTS = 40  # in how many steps
LAG_MAX_S = 0.08  # longest time constant of a wheel on a rehearsed day
WHEEL_OFF = 0.05  # most by which the speed of a wheel is off on such a day
Wheel = Literal["left", "right", "both"]
Count = Annotated[int, Field(ge=-127, le=127)]


class WheeledSide(PluggedDevices):
    """Base class of emulated actuators for robots with two wheels.

    Attributes:
        robots: The robots, in the order of the setup.
        wheels: Moves the robots.
        radios: The radios that deliver messages to the robots.
        timeline: The emulation's timeline.
    """

    what = "robots"
    robots: Sequence[EmulatedRobot]
    wheels: EmulatedRobots
    radios: Sequence[RobotRadio]
    timeline: Timeline

    @property
    def wired(self) -> Sequence[RobotRadio]:
        """The emulated radios, each of which is connected to its own port."""
        return self.radios

    @property
    def bodies(self) -> Sequence[EmulatedRobot]:
        """The emulated robots at their true poses, in the order of the setup."""
        return self.robots

    @property
    def driven(self) -> bool:
        """Whether any motor of any robot has a count other than 0 at present."""
        return any(any(robot.counts()) for robot in self.robots)

    @property
    def truth(self) -> dict[str, Any]:
        """The true wheel speeds and statuses, for the record.

        The keys are "wheels", [[left, right], ...] [mm/s], and "status", with the flags of each
        robot's program.
        """
        speeds = (robot.wheels for robot in self.robots)
        wheels = [[round(left, 2), round(right, 2)] for left, right in speeds]
        status = [int(robot.status) for robot in self.robots]
        return {"wheels": wheels, "status": status}

    def switch(self, on: bool) -> None:
        """Switch the power of every emulated robot on or off."""
        for robot in self.robots:
            robot.switch(on)

    def advance(self, until_ns: int) -> None:
        """Advance the robots to the time `until_ns` [ns]."""
        self.wheels.advance(until_ns)

    def tick(self) -> None:
        """Send the replies that the emulated robots have ready. Each reply is sent once."""
        for radio in self.radios:
            radio.poll_answers()

    def robot(self, name: str) -> EmulatedRobot:
        """Return the robot with this name, which must exist."""
        return next(robot for robot in self.robots if robot.name == name)

    def push(self, fault: Any) -> None:
        """Displace a robot as the fault `pushed` specifies, in small steps or at once.

        In small steps, the displacement takes PUSH_NS.
        """
        row = self.robot(fault.robot).row
        parts = 1 if fault.at_once else PUSH_PARTS
        x, y, turn = (value / parts for value in (*fault.by, fault.turn))
        for part in range(parts):
            at_ns = self.timeline.now_ns + part * PUSH_NS // PUSH_PARTS
            self.timeline.at(at_ns, lambda: self.wheels.shift(row, x, y, turn))

    def drive_elsewhere(self, fault: Any) -> Undo:
        """Send commands to the robots as if from another program, until the fault ends.

        The commands are numbered from 0. If the fault `follows`, each has the number after the
        newest command of our program instead.

        Args:
            fault: A fault of the kind `driven_elsewhere`.

        Returns:
            A function that ends the fault.
        """
        period_ns = round(SECOND / fault.rate)
        ends_ns = NEVER

        def send(number: int) -> None:
            if self.timeline.now_ns >= ends_ns:
                return
            for radio in self.radios:
                sequence = radio.sequence + 1 if fault.follows else number
                radio.drive_elsewhere(sequence % 256, fault.counts)
            self.timeline.at(self.timeline.now_ns + period_ns, lambda: send(number + 1))

        def end() -> None:
            nonlocal ends_ns
            ends_ns = self.timeline.now_ns

        send(0)
        return end

    def stop_elsewhere(self) -> None:
        """Schedule ten emergency stops for the robots from now on, as if from another program."""
        for k in range(STOPS):
            for radio in self.radios:
                at_ns = self.timeline.now_ns + k * STOP_GAP_NS
                self.timeline.at(at_ns, lambda k=k, radio=radio: radio.stop_elsewhere(k))


class TrueWheels(Model):
    """The true properties of one emulated robot, if they differ from the values in the spec."""

    name: Name
    """Name of a robot of the spec."""
    left_gain: Positive | None = None
    """True speed of the left wheel over the speed that it was sent."""
    right_gain: Positive | None = None
    """True speed of the right wheel over the speed that it was sent."""
    lag: Annotated[float, Field(gt=0, le=1)] = 0.04
    """Time constant of the wheels [s]."""
    battery_mv: int = Field(default=BATTERY_MV, ge=0, le=9000)
    """The battery's voltage without load [mV]."""


class WheelsSettings(Model):
    """Properties of the radio and the robots that differ from the spec."""

    loss: Share = 0.0
    """Probability that a robot does not receive a line."""
    robots: tuple[TrueWheels, ...] = ()
    """The robots whose true properties differ from the spec."""


def robots_of_day(
    random: Random, names: Sequence[str], wheel: str, gain: Callable[[float], Any]
) -> dict[str, Any]:
    """Sample true properties of the radio and the robots for a randomised test run.

    Args:
        random: The random generator.
        names: The robots.
        wheel: Name of a wheel's field, with a placeholder for the side, such as "{}_gain".
        gain: Returns the value of that field for a wheel's relative speed, within WHEEL_OFF of 1.

    Returns:
        A section `actuator` of a script's `emulation`: "loss" and "robots".
    """
    robots: list[dict[str, Any]] = []
    for name in names:
        robot: dict[str, Any] = {"name": name}
        for side in ("left", "right"):
            robot[wheel.format(side)] = gain(1 + random.uniform(-WHEEL_OFF, WHEEL_OFF))
        robot |= {"lag": round(random.uniform(0.02, LAG_MAX_S), 3)}
        robots.append(robot | {"battery_mv": random.randint(4600, 5300)})
    return {"loss": round(random.uniform(0, 0.05), 3), "robots": robots}


class PortedSide(WheeledSide):
    """A `WheeledSide` whose section of the spec has an entry for each robot.

    The entry contains `radius_mm`, `left_gain` and `right_gain`. These values are the true ones
    unless the settings differ.

    Args:
        stage: What the emulated devices share.
        settings: Properties of the radio and the robots that differ from the spec.
        limit: Maximum count of a motor, and the wheel speed for one count [mm/s].

    Attributes:
        stated: The entries of the section, in the order of the setup.
        radii: Distance from a wheel to each robot's centre, shape (N,) [mm].
    """

    Settings: ClassVar[type[Model]] = WheelsSettings

    @classmethod
    def world_of_day(cls, random: Random, lab: LabSection, setup: Setup) -> dict[str, Any]:
        """Sample true properties of the radio and the robots for a randomised test run.

        The wheel gains are near those of the section. See `tetractl_emulator.sides`.

        Args:
            random: The random generator.
            lab: The lab's section of the spec.
            setup: The constants of the experiment.
        """
        section: Any = lab.actuator
        drawn = robots_of_day(random, setup.names, "{}_gain", lambda fraction: round(fraction, 4))
        for robot in drawn["robots"]:
            stated = entry(section.robots, robot["name"])
            robot["left_gain"] *= stated.left_gain
            robot["right_gain"] *= stated.right_gain
        return drawn

    def __init__(self, stage: Stage, settings: WheelsSettings, limit: tuple[float, float]) -> None:
        section: Any = stage.lab.actuator
        setup = stage.setup
        self.stated = [entry(section.robots, name) for name in setup.names]
        self.radii = radii_mm(setup, [stated.radius_mm for stated in self.stated])
        given = {true.name: true for true in settings.robots}
        trues = [given.get(name) or TrueWheels(name=name) for name in setup.names]
        gains = [
            (true.left_gain or stated.left_gain, true.right_gain or stated.right_gain)
            for true, stated in zip(trues, self.stated, strict=True)
        ]
        self.robots = [
            self.make_robot(row, true.name, true.battery_mv, stage.acting)
            for row, true in enumerate(trues)
        ]
        wheels = wheels_by_speed(np.array(gains).T * limit[1], limit[0])
        lags = np.array([true.lag for true in trues])
        self.timeline = stage.timeline
        self.wheels = EmulatedRobots(self.robots, wheels, self.radii, lags, stage.timeline.now_ns)

    @abstractmethod
    def make_robot(
        self, row: int, name: str, battery_mv: int, acting: ActingFaults
    ) -> EmulatedRobot:
        """Create a robot with its program.

        Args:
            row: Index of the robot in the setup.
            name: Its name.
            battery_mv: Voltage of its battery without load [mV].
            acting: The faults that act now.
        """


def _swap_numbers(fault: Any, device: Any) -> Undo:
    """Begin the fault `swapped_numbers`: exchange the indices of two robots' firmware.

    It returns a function that exchanges them back.
    """

    def swap() -> None:
        first = device.robot(fault.robot)
        second = device.robot(fault.other)
        index = first.index
        first.renumber(second.index)
        second.renumber(index)

    swap()
    return swap


ELSEWHERE = f"only an emergency stop|{MOTION_REASONS}|{PLACE_REASONS}"
SENDER = {
    "counts": pair(signed_value(3, 60)),
    "rate": one_of(20.0, DEFAULT_COMMAND_HZ, 100.0, 200.0),
}
DRIVEN_ELSEWHERE = fault_kind(
    "driven_elsewhere",
    "Another program on the radio sends these counts to all robots, at this rate [Hz]. Its "
    "commands have sequence numbers of their own. If `follows` is set, they continue the "
    "sequence numbers of our commands.",
    fields={
        "counts": tuple[Count, Count],
        "rate": (Positive, 100.0),
        "follows": (bool, False),
    },
    rows=[
        FaultRow("second sender", ELSEWHERE, SENDER),
        FaultRow("sender that follows", ELSEWHERE, SENDER | {"follows": True}),
        FaultRow("sender as robots stop", ELSEWHERE, SENDER, start=0.0, stop=1.0),
        FaultRow("sender before the run", ELSEWHERE, SENDER, start=1.0, weight=0.5),
    ],
    begin=lambda fault, device: device.drive_elsewhere(fault),
)
"""The fault of a second program, for robots whose commands another program can make."""
WHEELED_FAULTS = (
    fault_kind(
        "wheel_stuck",
        "One or both wheels no longer turn.",
        fields={"robot": Name, "wheel": Wheel},
        rows=[FaultRow("wheel stuck", MOVED_REASONS, {"wheel": WHEEL_SIDES})],
    ),
    *port_faults("radio", RADIO_REASONS, RADIO_REASONS),
    fault_kind(
        "loss",
        "This fraction of the transmissions reaches no robot.",
        fields={"share": Share},
        rows=[FaultRow("radio silent", LINK_REASONS, {"share": lost_fraction})],
    ),
    fault_kind(
        "deaf",
        "This fraction of the transmissions does not reach one of the robots.",
        fields={"robot": Name, "share": Share},
        rows=[FaultRow("robot deaf", LINK_REASONS, {"share": lost_fraction})],
    ),
    fault_kind(
        "swapped_numbers",
        "Two robots have swapped numbers: each obeys the commands for the other.",
        fields={"robot": Name, "other": Name},
        rows=[FaultRow("numbers swapped", MOVED_REASONS, at_once=True, start=1.0)],
        begin=_swap_numbers,
    ),
    fault_kind(
        "late_radio",
        "Transmissions arrive late by this time [s].",
        fields={"by": Positive},
        rows=[FaultRow("radio late", LINK_REASONS, {"by": value_between(0.005, 1)})],
    ),
    fault_kind(
        "stopped_elsewhere",
        "Robots receive `tetractl lab stop` from another radio: ten emergency stops.",
        rows=[FaultRow("stopped elsewhere", f"emergency-stopped|{LINK_REASONS}", at_once=True)],
        begin=lambda f, d: d.stop_elsewhere(),
    ),
    fault_kind(
        "overtaken_packets",
        "Transmissions arrive late by a random time of up to this value [s], so that some "
        "overtake others.",
        fields={"by": Positive},
        rows=[FaultRow("packets overtaken", LINK_REASONS, {"by": value_between(0.02, 1)})],
    ),
    fault_kind(
        "doubled_packets",
        "Robots receive each transmission twice.",
        rows=[FaultRow("packets doubled", NO_REASON, weight=0.5)],
    ),
    fault_kind(
        "radio_resets",
        "The radio's module restarts: it neither accepts nor sends bytes until it has started.",
        rows=[FaultRow("radio resets", LINK_REASONS)],
    ),
    fault_kind(
        "baud",
        "The radio's module is set to another baud rate.",
        fields={"baud": Literal[9600, 19200, 38400, 115200]},
        rows=[FaultRow("other baud rate", LINK_REASONS, {"baud": 9600})],
    ),
    fault_kind(
        "bad_bytes",
        "This fraction of the bytes on the wire to and from the radio is changed.",
        fields={"share": Share},
        rows=[FaultRow("bad bytes", LINK_REASONS, {"share": value_between(2e-4, 0.5)})],
    ),
    fault_kind(
        "weak_wheel",
        "A wheel turns at this fraction of its commanded speed.",
        fields={"robot": Name, "wheel": Wheel, "share": Share},
        rows=[
            FaultRow(
                "wheel weak", MOVED_REASONS, {"wheel": WHEEL_SIDES, "share": one_minus(0.02, 1.2)}
            )
        ],
    ),
    fault_kind(
        "pushed",
        "Somebody moves a robot on the floor by this distance [mm] and angle [rad]. The move "
        "takes 0.2 s, or no time if the robot is lifted and put elsewhere.",
        fields={"robot": Name, "by": Point, "turn": (Finite, 0.0), "at_once": (bool, False)},
        rows=[
            FaultRow(
                "pushed",
                MOVED_REASONS,
                {"by": scaled_vector(3, 200), "turn": signed_value(0.01, 2)},
                at_once=True,
            ),
            FaultRow(
                "put elsewhere",
                MOVED_REASONS,
                {"by": scaled_vector(10, 600), "turn": signed_value(0.01, 2), "at_once": True},
                at_once=True,
            ),
        ],
        begin=lambda f, d: d.push(f),
    ),
    fault_kind(
        "off",
        "A robot is switched off.",
        fields={"robot": Name},
        rows=[FaultRow("brown-out", LINK_REASONS)],
        begin=switching(lambda f, d: d.robot(f.robot).switch, False),
    ),
    fault_kind(
        "reboots",
        "A robot restarts. Afterwards it obeys commands late by this time [s].",
        fields={"robot": Name, "by": Positive},
        rows=[FaultRow("late after a reboot", LINK_REASONS, {"by": value_between(0.05, 3)})],
        begin=lambda f, d: d.robot(f.robot).switch(True),
    ),
    fault_kind(
        "low_battery",
        "A robot's battery has this voltage [mV].",
        fields={"robot": Name, "millivolts": Annotated[int, Field(ge=0, le=9000)]},
        rows=[
            FaultRow("battery low", "battery", {"millivolts": whole_number(4700, 3500)}, start=0.9)
        ],
    ),
)
"""The faults of a `WheeledSide`."""
