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

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheel_commands import radii_mm, wheels_by_speed
from tetractl.spec.base import Finite, Model, Name, Point, Positive
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS, LabSection, entry
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
    scaled_vector,
    signed_value,
    two_whole_numbers,
    value_between,
    whole_number,
)
from tetractl_emulator.faults import (
    ActingFaults,
    Share,
    Undo,
    begin_by_switching,
    fault_kind,
    port_faults,
)
from tetractl_emulator.loop import Timeline
from tetractl_emulator.m3pi.robot import BATTERY_MV, EmulatedRobot, EmulatedRobots
from tetractl_emulator.m3pi.robot_radio import RobotRadio
from tetractl_emulator.port import PluggedDevices
from tetractl_emulator.sides import Stage

PUSH_NS = SECOND // 5
"""Time for which a robot is pushed along the floor [ns]."""
PUSH_STEPS = 40
"""Number of steps in which a pushed robot moves."""
LAG_MAX_S = 0.08
"""Maximum time constant of a wheel in a randomised test run [s]."""
WHEEL_ERROR_MAX = 0.05
"""Maximum relative error of a wheel's speed in a randomised test run."""
Wheel = Literal["left", "right", "both"]
"""The wheels of a robot that a fault concerns."""
Count = Annotated[int, Field(ge=-127, le=127)]
"""The number that a command contains for the speed of a motor."""


class WheeledSide(PluggedDevices):
    """Base class of emulated actuators for robots with two wheels.

    Attributes:
        robots: The robots, in the order of the setup.
        wheels: The motion of all robots, which follows their wheel speeds.
        radios: The radios that deliver messages to the robots.
        timeline: The emulation's timeline.
    """

    description = "robots"
    robots: Sequence[EmulatedRobot]
    wheels: EmulatedRobots
    radios: Sequence[RobotRadio]
    timeline: Timeline

    @property
    def serial_devices(self) -> Sequence[RobotRadio]:
        """The emulated radios, each of which is connected to its own port."""
        return self.radios

    @property
    def bodies(self) -> Sequence[EmulatedRobot]:
        """The emulated robots at their true poses, in the order of the setup."""
        return self.robots

    @property
    def driven(self) -> bool:
        """Whether any motor of any robot is driven at present: its count is not 0."""
        return any(any(robot.counts()) for robot in self.robots)

    @property
    def truth(self) -> dict[str, Any]:
        """The true wheel speeds and status flags of all robots, for the record.

        The keys are "wheels", which maps to [[left, right], ...] [mm/s], and "status", which maps
        to the status flags of each robot's program.
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
        """Send the robots' waiting replies to the program. Each reply is sent once."""
        for radio in self.radios:
            radio.poll_answers()

    def robot(self, name: str) -> EmulatedRobot:
        """Return the robot with this name, which must exist."""
        return next(robot for robot in self.robots if robot.name == name)

    def push(self, fault: Any) -> None:
        """Displace a robot as the fault `pushed` specifies.

        The robot moves at once if the fault is `at_once`, and otherwise in small steps during
        PUSH_NS.
        """
        row = self.robot(fault.robot).row
        n_steps = 1 if fault.at_once else PUSH_STEPS
        x, y, turn = (value / n_steps for value in (*fault.by, fault.turn))
        for step in range(n_steps):
            at_ns = self.timeline.now_ns + step * PUSH_NS // PUSH_STEPS
            self.timeline.at(at_ns, lambda: self.wheels.shift(row, x, y, turn))

    def drive_from_other_program(self, fault: Any) -> Undo:
        """Drive the robots with commands as if from another program, until the fault ends.

        The commands are numbered from 0. If the fault sets `follows`, each command has the number
        after our program's newest command instead.

        Args:
            fault: A fault of the kind `driven_elsewhere`.

        Returns:
            A function that ends the fault.
        """
        period_ns = round(SECOND / fault.rate)
        end_ns = NEVER_NS

        def send(number: int) -> None:
            if self.timeline.now_ns >= end_ns:
                return
            for radio in self.radios:
                sequence = radio.sequence + 1 if fault.follows else number
                radio.drive_from_other_program(sequence % 256, fault.counts)
            self.timeline.at(self.timeline.now_ns + period_ns, lambda: send(number + 1))

        def end_fault() -> None:
            nonlocal end_ns
            end_ns = self.timeline.now_ns

        send(0)
        return end_fault

    def stop_from_other_program(self) -> None:
        """Send ten emergency stops to the robots from now on, as if from another program."""
        for i in range(STOP_COUNT):
            for radio in self.radios:
                at_ns = self.timeline.now_ns + i * STOP_GAP_NS
                self.timeline.at(at_ns, lambda i=i, radio=radio: radio.stop_from_other_program(i))


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
    random: Random, names: Sequence[str], wheel_field: str, gain_of: Callable[[float], Any]
) -> dict[str, Any]:
    """Sample true properties of the radio and the robots for a randomised test run.

    Args:
        random: The random generator.
        names: The robots.
        wheel_field: Name of a wheel's field, with a placeholder for the side, such as "{}_gain".
        gain_of: Returns the value of that field for a wheel's relative speed. The relative speed
            differs from 1 by at most WHEEL_ERROR_MAX.

    Returns:
        A section `actuator` of a script's `emulation`, with the keys "loss" and "robots".
    """
    robots: list[dict[str, Any]] = []
    for name in names:
        robot: dict[str, Any] = {"name": name}
        for side in ("left", "right"):
            robot[wheel_field.format(side)] = gain_of(
                1 + random.uniform(-WHEEL_ERROR_MAX, WHEEL_ERROR_MAX)
            )
        robot |= {"lag": round(random.uniform(0.02, LAG_MAX_S), 3)}
        robots.append(robot | {"battery_mv": random.randint(4600, 5300)})
    return {"loss": round(random.uniform(0, 0.05), 3), "robots": robots}


class PortedSide(WheeledSide):
    """Base class of emulated actuators whose section of the spec has an entry for each robot.

    The entry contains `radius_mm`, `left_gain` and `right_gain`. The emulated robot has these true
    values, unless the settings differ.

    Args:
        stage: The data and functions that the emulated devices share.
        settings: Properties of the radio and the robots that differ from the spec.
        limit: Maximum count of a motor, and the wheel speed for one count [mm/s].

    Attributes:
        spec_entries: The entries of the section, in the order of the setup.
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
        sampled = robots_of_day(random, setup.names, "{}_gain", lambda fraction: round(fraction, 4))
        for robot in sampled["robots"]:
            spec_entry = entry(section.robots, robot["name"])
            robot["left_gain"] *= spec_entry.left_gain
            robot["right_gain"] *= spec_entry.right_gain
        return sampled

    def __init__(self, stage: Stage, settings: WheelsSettings, limit: tuple[float, float]) -> None:
        section: Any = stage.lab.actuator
        setup = stage.setup
        self.spec_entries = [entry(section.robots, name) for name in setup.names]
        self.radii = radii_mm(setup, [spec_entry.radius_mm for spec_entry in self.spec_entries])
        override_by_name = {true_robot.name: true_robot for true_robot in settings.robots}
        true_robots = [override_by_name.get(name) or TrueWheels(name=name) for name in setup.names]
        gains = [
            (
                true_robot.left_gain or spec_entry.left_gain,
                true_robot.right_gain or spec_entry.right_gain,
            )
            for true_robot, spec_entry in zip(true_robots, self.spec_entries, strict=True)
        ]
        self.robots = [
            self.make_robot(row, true_robot.name, true_robot.battery_mv, stage.acting)
            for row, true_robot in enumerate(true_robots)
        ]
        drivetrains = wheels_by_speed(np.array(gains).T * limit[1], limit[0])
        lags_s = np.array([true_robot.lag for true_robot in true_robots])
        self.timeline = stage.timeline
        self.wheels = EmulatedRobots(
            self.robots, drivetrains, self.radii, lags_s, stage.timeline.now_ns
        )

    @abstractmethod
    def make_robot(
        self, row: int, name: str, battery_mv: int, acting: ActingFaults
    ) -> EmulatedRobot:
        """Create a robot with its program.

        Args:
            row: Index of the robot in the setup.
            name: Name of the robot.
            battery_mv: Voltage of the robot's battery without load [mV].
            acting: The faults that act now.
        """


def _begin_swapped_numbers(fault: Any, device: Any) -> Undo:
    """Begin the fault `swapped_numbers`: exchange the indices of two robots' firmware.

    Returns:
        A function that exchanges the indices back.
    """

    def swap() -> None:
        first_robot = device.robot(fault.robot)
        second_robot = device.robot(fault.other)
        index = first_robot.index
        first_robot.renumber(second_robot.index)
        second_robot.renumber(index)

    swap()
    return swap


OTHER_SENDER_REASONS = f"only an emergency stop|{MOTION_REASONS}|{PLACE_REASONS}"
# fields of the fault `driven_elsewhere` in randomised test runs
OTHER_SENDER_FIELDS = {
    "counts": two_whole_numbers(signed_value(3, 60)),
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
        FaultRow("second sender", OTHER_SENDER_REASONS, OTHER_SENDER_FIELDS),
        FaultRow(
            "sender that follows", OTHER_SENDER_REASONS, OTHER_SENDER_FIELDS | {"follows": True}
        ),
        FaultRow(
            "sender as robots stop",
            OTHER_SENDER_REASONS,
            OTHER_SENDER_FIELDS,
            start_fraction=0.0,
            stop_fraction=1.0,
        ),
        FaultRow(
            "sender before the run",
            OTHER_SENDER_REASONS,
            OTHER_SENDER_FIELDS,
            start_fraction=1.0,
            weight=0.5,
        ),
    ],
    begin=lambda fault, device: device.drive_from_other_program(fault),
)
"""The fault that another program drives the robots, if another program can send commands."""
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
        rows=[FaultRow("numbers swapped", MOVED_REASONS, at_once=True, start_fraction=1.0)],
        begin=_begin_swapped_numbers,
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
        begin=lambda f, d: d.stop_from_other_program(),
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
        begin=begin_by_switching(lambda f, d: d.robot(f.robot).switch, False),
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
            FaultRow(
                "battery low",
                "battery",
                {"millivolts": whole_number(4700, 3500)},
                start_fraction=0.9,
            )
        ],
    ),
)
"""The faults of a `WheeledSide`."""
