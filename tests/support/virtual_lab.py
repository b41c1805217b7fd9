"""The emulated m3pi lab in virtual time: its radio, its robots with their firmware, our whole side.

Everything of the lab's side that is not a wire is the real code: plant, guard, inner loop, actuator
and XBee frames on ours; module, air, loss, firmware, wheels on the other. Virtual time and the
serial port in memory are what differs from `tetractl lab emulate`, so that a loaded host changes
nothing.
"""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from support.labs import CAMERA_HZ

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Command, Health
from tetractl.core.plan import End, Outcome, Plan
from tetractl.core.poses import CameraFrame, Observation, Pose
from tetractl.core.protocols import Controller, LabSupervision
from tetractl.emulate.loop import Timeline
from tetractl.emulate.m3pi.robot import EmulatedRobot
from tetractl.emulate.m3pi.side import EmulatedM3pi, M3piSettings
from tetractl.emulate.optitrack.motive import JITTER_S, OptitrackSettings
from tetractl.emulate.sides import Options, Stage
from tetractl.emulate.virtual_wires import STEP_NS, LabClock, VirtualLoop, memory_wires
from tetractl.experiment.experiment import Experiment
from tetractl.lab.actuators.m3pi.actuator import M3piActuator
from tetractl.lab.inner_loop import IDLE_S
from tetractl.lab.rig import Rig
from tetractl.plant.lab_plant import LabPlant


class EmulatedEye:
    """A camera, at 120 Hz by default, that sees the robots with the emulated Motive's delays.

    `noise` are the standard deviations of a pose [mm, rad]. `shown` changes what is seen: of the
    robots' poses, in each frame.
    """

    def __init__(
        self,
        clock: LabClock,
        robots: Sequence[EmulatedRobot],
        seed: int,
        noise: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.clock, self.robots, self.noise = clock, robots, noise
        self.shown: Callable[[tuple[Pose, ...]], tuple[Pose | None, ...]] = lambda poses: poses
        self.newest: CameraFrame | None = None
        self.damaged = 0
        self.settings = OptitrackSettings(rate=CAMERA_HZ)
        self._random = random.Random(seed)
        self._fresh: list[CameraFrame] = []
        self._count = 0

    def __enter__(self):
        self._start_ns = self.clock.now()
        self._expose()
        while self.newest is None:
            self.clock.sleep_until(self.clock.now() + STEP_NS)
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def check(self) -> Health:
        return Health(facts={"camera": "emulated"})

    @property
    def waiting(self) -> bool:
        return bool(self._fresh)

    def frames(self) -> list[CameraFrame]:
        fresh, self._fresh = self._fresh, []
        return fresh

    def _expose(self) -> None:
        now, s, draw = self.clock.timeline.now_ns, self.settings, self._random
        delay = s.latency + min(max(draw.gauss(0, JITTER_S), -4 * JITTER_S), 4 * JITTER_S)
        if draw.random() < 1 / 250:
            delay += draw.uniform(0, 0.45 / s.rate)
        way, turn = self.noise
        poses = tuple(
            Pose(
                robot.x + draw.gauss(0, way),
                robot.y + draw.gauss(0, way),
                robot.heading + draw.gauss(0, turn),
            )
            for robot in self.robots
        )
        arrives = now + round(delay * SECOND)
        self._count += 1
        frame = CameraFrame(self._count, now, arrives, self.shown(poses))
        self.clock.timeline.at(arrives, lambda: self._arrive(frame))
        due = self._start_ns + round(self._count * SECOND / s.rate)
        self.clock.timeline.at(due, self._expose)

    def _arrive(self, frame: CameraFrame) -> None:
        self.newest = frame
        self._fresh.append(frame)


class Busy:
    """A controller that takes virtual time: uniform from `least` to `least + spread` [s]."""

    def __init__(
        self, controller: Controller, clock: VirtualClock, rng, least: float, spread: float
    ) -> None:
        self._controller, self._clock, self._rng = controller, clock, rng
        self._least, self._spread, self._planned = least, spread, False

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        decided = self._controller.plan(observation, last_command, earlier)
        if self._planned:  # the first plan is computed while the robots stand
            seconds = self._least + self._spread * self._rng.random()
            self._clock.sleep_until(self._clock.now() + round(seconds * SECOND))
        self._planned = True
        return decided


@dataclass
class VirtualLab:
    plant: LabPlant
    clock: LabClock
    robots: Sequence[EmulatedRobot]
    eye: EmulatedEye


def virtual_lab(
    experiment: Experiment,
    settings: M3piSettings,
    starts,
    seed: int,
    noise: tuple[float, float] = (0.0, 0.0),
) -> VirtualLab:
    """Return the lab of a spec with a `lab` section; `starts` (N, 3) is where robots truly stand.

    Lengths are mm, as in the emulated lab.
    """
    setup, lab = experiment.setup, experiment.lab
    assert lab is not None
    clock = LabClock()
    clock.timeline = Timeline(lambda until: side.advance(until))

    def ignore(*_: object, **__: object) -> None:
        pass

    reports = ignore, ignore, ignore, ignore
    wires = memory_wires(clock)
    stage = Stage(lab, setup, clock.timeline, Options(seed=seed), *reports, wires)
    side = EmulatedM3pi(stage, settings)
    actuator = M3piActuator(lab.actuator, setup, clock, wires.ports)
    side.open(VirtualLoop(clock.timeline, ignore))
    actuator.link._port.open()
    actuator.link.open = ignore  # the module on it is not checked
    side.port.written = side.radio.readable
    robots = side.robots
    for robot, (x, y, heading) in zip(robots, np.asarray(starts), strict=True):
        robot.place(float(x), float(y), float(heading))
    eye, supervision = EmulatedEye(clock, robots, seed, noise), LabSupervision()
    rig = Rig(eye, actuator, lab.limits, setup, clock, supervision.emergency, threaded=False)
    due = 0

    def turn() -> None:
        """Step the inner loop when its thread would: at each frame, else every IDLE_S."""
        nonlocal due
        if eye.waiting or clock.now() >= due:
            due = clock.now() + round(IDLE_S * SECOND)
            rig.loop.step()

    clock.steps += [side.tick, turn]
    return VirtualLab(LabPlant(rig, supervision), clock, robots, eye)
