"""A lab in use: cameras, radio, guard and drive, put together from a spec."""

import math
import threading
from collections.abc import Callable

from tetractl.core.clock import SECOND, Clock
from tetractl.core.poses import CameraFrame
from tetractl.core.setup import METRES
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab import LabRobot, LabSpec, LabWheel, Slave
from tetractl.lab.actuators.m3pi.command import Drivetrain, Wheel
from tetractl.lab.actuators.m3pi.protocols import Voice, build_voice
from tetractl.lab.actuators.xbee.link import Link
from tetractl.lab.cameras.optitrack.client import NatNetClient
from tetractl.lab.cameras.optitrack.stream import Tracked
from tetractl.lab.guard import Guard, Rules
from tetractl.lab.inner_loop import Body, Drive
from tetractl.lab.wire_tap import NO_TAP, Tap

MM = 1e-3  # m


class Session:
    """Everything between the wires and a plant; robots are in the order of the experiment."""

    def __init__(
        self,
        experiment: Experiment,
        lab: LabSpec,
        clock: Clock,
        operator: threading.Event,
        tap: Tap = NO_TAP,
        on_snapshot: Callable[[CameraFrame, Guard], None] = lambda snapshot, guard: None,
    ) -> None:
        by_name = {robot.name: robot for robot in lab.robots}
        robots = [by_name[robot.name] for robot in experiment.robots]
        indices = {robot.name: lab.index(robot) for robot in robots}
        robots = [r.model_copy(update={"index": indices[r.name]}) for r in robots]
        self.experiment = experiment
        self.lab = lab = lab.model_copy(update={"robots": tuple(robots)})
        self.clock = clock
        self.metres = METRES[experiment.units.length]
        self.mm = self.metres / MM  # millimetres in a length unit
        self.guard = Guard(rules(experiment, lab))
        tracked = [Tracked(robot.body, robot.heading_offset) for robot in robots]
        self.client = NatNetClient(lab.mocap, tracked, self.metres, clock, tap, self._woken)
        self.link = Link(lab.radio, clock, tap)
        self.voice: Voice = build_voice(lab, self.link, clock)
        self.bodies = [body(experiment, lab, i) for i in range(len(robots))]
        self.drive = Drive(
            self.bodies,
            self.mm,
            self.client,
            self.link,
            self.voice,
            self.guard,
            clock,
            round(SECOND / lab.radio.rate),
            operator,
            on_snapshot,
        )

    def open(self) -> None:
        """Open the radio, connect to the cameras, and watch; AbortError says what is wrong."""
        self.link.open()
        self.client.open()
        self.client.wait_connected(self.lab.limits.connect)
        self.drive.start()

    def close(self) -> None:
        """Let go of everything; idempotent, never raises."""
        self.drive.close()
        self.client.close()
        self.link.close()

    def _woken(self) -> None:
        self.drive.wake.set()


def rules(experiment: Experiment, lab: LabSpec) -> Rules:
    """Return what the guard goes by, in the spec's length unit."""
    limits, arena, robots = lab.limits, experiment.arena, experiment.robots
    per_mm = MM / METRES[experiment.units.length]
    edge = limits.edge_mm * per_mm
    control = experiment.controller
    silence = control.period * (limits.late_steps + 1)
    return Rules(
        names=tuple(robot.name for robot in robots),
        speeds=tuple(robot.speed for robot in robots),
        turning=tuple(robot.a for robot in robots),
        left=arena.left + edge,
        bottom=arena.bottom + edge,
        right=arena.left + arena.width - edge,
        top=arena.bottom + arena.height - edge,
        separation=limits.separation_mm * per_mm,
        jump=limits.jump_mm * per_mm,
        stale_ns=round(limits.stale * SECOND),
        stream_lost_ns=round(limits.stream_lost * SECOND),
        untracked_stop_ns=round(limits.untracked_stop * SECOND),
        untracked_abort_ns=round(limits.untracked_abort * SECOND),
        reaction_ns=round(limits.reaction * SECOND),
        bad_datagrams=limits.bad_datagrams,
        late_steps=limits.late_steps,
        silence_ns=round(max(silence, 0.5) * SECOND),
        disobedience_ns=round(limits.disobedience * SECOND),
    )


def body(experiment: Experiment, lab: LabSpec, i: int) -> Body:
    """Return what turns a direction into counts for robot i, in millimetres."""
    robot, mine = experiment.robots[i], lab.robots[i]
    mm = METRES[experiment.units.length] / MM
    radius = mine.radius_mm
    if radius is None:
        assert experiment.wheels is not None, "the spec's check asks for wheels in a lab"
        radius = experiment.wheels.radius * mm
    return Body(robot.a, robot.speed * mm, radius, drivetrain(mine, lab))


def drivetrain(robot: LabRobot, lab: LabSpec) -> Drivetrain:
    """Return a robot's wheels, capped where its program has no watchdog."""
    limit = robot.limit
    if isinstance(lab.protocol, Slave):
        limit = min(limit, lab.protocol.limit)
    return Drivetrain(_wheel(robot.left), _wheel(robot.right), robot.swap, limit)


def _wheel(wheel: LabWheel) -> Wheel:
    return Wheel(wheel.gain_mm, wheel.dead_zone, wheel.invert)


def heading_gap(a: float, b: float) -> float:
    """Return the angle from b to a, in [-pi, pi]."""
    return math.remainder(a - b, math.tau)
