"""The emulated actuator of type `twist`: its settings and faults, ports, and robots."""

from collections.abc import Sequence
from functools import partial
from operator import attrgetter
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from tetractl.experiment.base import Model, Name, Positive
from tetractl.experiment.lab_section import entry
from tetractl.lab.actuators.twist.actuator import drivetrains
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.actuators.wheel_commands import radii_mm
from tetractl_emulator.faults import STUCK_PORT, UNPLUG, Fault, Share, fault, settings, switching
from tetractl_emulator.firmware import TwistCore
from tetractl_emulator.loop import Loop
from tetractl_emulator.m3pi.robot import EmulatedBattery, EmulatedRobot, EmulatedRobots
from tetractl_emulator.sides import Stage
from tetractl_emulator.twist.radio import LineRadio

STUCK = {"left": (True, False), "right": (False, True), "both": (True, True)}


class TrueTwistRobot(Model):
    """A robot's true properties that differ from the spec."""

    name: Name
    """Name of a robot of the spec."""
    left_gain: Positive | None = None
    """True speed of the left wheel over the speed that it was sent."""
    right_gain: Positive | None = None
    """True speed of the right wheel over the speed that it was sent."""
    lag: Annotated[float, Field(gt=0, le=1)] = 0.04
    """Time constant of the wheels [s]."""
    battery_mv: int = Field(default=5100, ge=0, le=9000)
    """The battery's voltage without load [mV]."""


class TwistSettings(Model):
    """Properties of the radio and the robots that differ from the spec."""

    loss: Share = 0.0
    """Probability that a robot does not receive a line."""
    robots: tuple[TrueTwistRobot, ...] = ()
    """The robots whose true properties differ from the spec."""


def _robot_of(device: Any, fault: Any) -> EmulatedRobot:
    return device.robot(fault.robot)


FAULTS = (
    UNPLUG,
    STUCK_PORT,
    fault(
        "loss",
        "Robots do not receive this fraction of the lines.",
        settings(lambda d, f: d, loss=attrgetter("share")),
        share=Share,
    ),
    fault(
        "off",
        "A robot is switched off.",
        switching(lambda d, f: _robot_of(d, f).switch, False),
        robot=Name,
    ),
    fault(
        "wheel_stuck",
        "One or both wheels no longer turn.",
        settings(_robot_of, stuck=lambda f: STUCK[f.wheel]),
        robot=Name,
        wheel=Annotated[str, Field(pattern="^(left|right|both)$")],
    ),
    fault(
        "low_battery",
        "A robot's battery has this voltage [mV].",
        settings(
            lambda d, f: _robot_of(d, f).battery, open_mv=lambda f: float(f.millivolts), sag_mv=0.0
        ),
        robot=Name,
        millivolts=Annotated[int, Field(ge=0, le=9000)],
    ),
)


class EmulatedTwist:
    """Robots that run the firmware's core, on the ports of the spec; `loss` is the probability that
    a robot does not receive a line."""

    Settings: ClassVar[type[Model]] = TwistSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS

    def __init__(self, stage: Stage, settings: TwistSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, TwistSection), "the actuator's section has the type twist"
        truths = {truth.name: truth for truth in settings.robots}
        names = stage.setup.names
        trues = [truths.get(name) or TrueTwistRobot(name=name) for name in names]
        own = [entry(section.robots, name) for name in names]
        radii = radii_mm(stage.setup, [robot.radius_mm for robot in own])
        self.loss, self._loop = settings.loss, None
        self._robots = [
            EmulatedRobot(
                name,
                section.index(name),
                EmulatedBattery(float(true.battery_mv)),
                partial(TwistCore, radius_mm=round(radius)),
            )
            for name, true, radius in zip(names, trues, radii.tolist(), strict=True)
        ]
        gains = [
            (true.left_gain or one.left_gain, true.right_gain or one.right_gain)
            for true, one in zip(trues, own, strict=True)
        ]
        wheels = drivetrains(np.array(gains).T, section.speed_max_mm_s)
        lags = np.array([true.lag for true in trues])
        self._wheels = EmulatedRobots(self._robots, wheels, radii, lags, stage.timeline.now_ns)
        others = {section.port: stage.options.link or section.port}
        self._radios = [
            LineRadio(
                stage,
                stage.wires.port(others.get(port, port)),
                section.baud,
                [robot for robot in self._robots if section.port_of(robot.name) == port],
                lambda: self.loss,
                stage.options.seed + i,
            )
            for i, port in enumerate(section.ports())
        ]

    @property
    def bodies(self) -> Sequence[EmulatedRobot]:
        """The robots, in the order of the setup."""
        return self._robots

    @property
    def driven(self) -> bool:
        """Whether any motor is driven."""
        return any(any(robot.counts()) for robot in self._robots)

    @property
    def truth(self) -> dict[str, Any]:
        """The speeds of all wheels [mm/s], to be recorded as {"wheels": [[left, right], ...]}."""
        return {"wheels": [[round(wheel, 2) for wheel in robot.wheels] for robot in self._robots]}

    @property
    def port(self) -> "EmulatedTwist":
        """What `stuck_port` stalls: all ports."""
        return self

    def stall(self, stalled: bool) -> None:
        """Let all ports take no bytes, or take them again."""
        for radio in self._radios:
            radio.port.stall(stalled)

    def open(self, loop: Loop) -> dict[str, Any]:
        """Plug in all ports; return a description and the first port's name."""
        self._loop = loop
        self.plugged(True)
        ports = [str(radio.port.link) for radio in self._radios]
        return {"actuator": f"robots at {', '.join(ports)}", "port": ports[0]}

    def close(self) -> dict[str, Any]:
        """Unplug all ports; return how many chunks of bytes came at a wrong baud rate."""
        self.plugged(False)
        return {"garbled": sum(radio.garbled for radio in self._radios)}

    def plugged(self, on: bool) -> None:
        """Plug all ports in, after `open`, or unplug them; they may be unplugged twice."""
        for radio in self._radios:
            if on:
                assert self._loop is not None, "open() sets the loop"
                radio.port.plug()
                self._loop.watch(radio.port.fd, radio.readable)
            else:
                if self._loop is not None:
                    self._loop.forget(radio.port.fd)
                radio.port.unplug()

    def switch(self, on: bool) -> None:
        """Switch every robot on or off."""
        for robot in self._robots:
            robot.switch(on)

    def advance(self, until_ns: int) -> None:
        """Advance the robots to `until_ns`."""
        self._wheels.advance(until_ns)

    def tick(self) -> None:
        """Send the robots' pending replies."""
        for radio in self._radios:
            radio.poll_answers()

    def robot(self, name: str) -> EmulatedRobot:
        """Return the robot with this name."""
        return next(robot for robot in self._robots if robot.name == name)
