"""A lab in virtual time: a fake camera and actuator around robots that follow the model."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Action, Steer, Stop, Transmission, Turn
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.protocols import Health, LabSupervision, RobotStatus
from tetractl.core.setup import Setup
from tetractl.lab.guard_checks import ChecksOf, robot_checks
from tetractl.lab.rig import Rig
from tetractl.model.motion.exact import step as exact
from tetractl.model.motion.wheel_equations import wheel_speeds
from tetractl.plant.lab_plant import LabPlant
from tetractl.spec.lab_section import LabLimits

STEP_NS = SECOND // 500
CAMERA_HZ = 120.0
LATENCY_NS = 5_000_000


class SteppedClock(VirtualClock):
    """Virtual time in steps of `STEP_NS`; in each, every function of `steps` runs."""

    def __init__(self) -> None:
        super().__init__()
        self.steps: list[Callable[[], None]] = []

    def sleep_until(self, when: int) -> None:
        while self.now() < when:
            next_ns = self.now() + STEP_NS
            super().sleep_until(min(when, next_ns))
            for step in tuple(self.steps):
                step()


@dataclass
class World:
    """N robots under one held direction; those that are not `moving` stand, `deaf` ones go on."""

    setup: Setup
    clock: SteppedClock
    direction: float = 0.0
    moving: tuple[bool, ...] = ()
    ahead: float = 1.0  # 0 while robots turn on the spot
    deaf: set[int] = field(default_factory=set)
    then_ns: int = 0

    def __post_init__(self) -> None:
        self.poses = self.setup.starts.array()
        self.moving = (False,) * len(self.poses)

    def advance(self) -> None:
        seconds = (self.clock.now() - self.then_ns) / SECOND
        moving = np.array(self.moving)
        self.then_ns = self.clock.now()
        moved = exact(
            *self.poses.T,
            np.array(self.direction),
            self.setup.a,
            self.setup.speed * self.ahead,
            seconds,
        )
        self.poses = np.where(moving[:, None], np.column_stack(moved), self.poses)


class FakeCamera:
    """Frames at `CAMERA_HZ` that arrive 5 ms after their exposure, once entered.

    `hidden` robots are not tracked; a `silent` camera exposes nothing. `standing` gives the height
    and tilt that are seen of a robot's body.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.clock = world.clock
        self.newest: CameraFrame | None = None
        self.damaged = 0
        self.hidden: set[str] = set()
        self.standing: dict[str, dict[str, float]] = {}
        self.silent = False
        self._exposed: list[CameraFrame] = []
        self._fresh: list[CameraFrame] = []
        self._count = 0

    def __enter__(self):
        self.clock.steps.insert(0, self._step)
        self._first_ns = self.clock.now()
        while self.newest is None:
            self.clock.sleep_until(self.clock.now() + STEP_NS)
        return self

    def __exit__(self, *_: object) -> None:
        if self._step in self.clock.steps:
            self.clock.steps.remove(self._step)

    def check(self) -> Health:
        return Health(facts={"camera": "fake"})

    def frames(self) -> list[CameraFrame]:
        fresh = self._fresh
        self._fresh = []
        return fresh

    def _step(self) -> None:
        self.world.advance()
        now = self.clock.now()
        while self._due_ns() <= now:
            due_ns = self._due_ns()
            self._count += 1
            if not self.silent:
                arrives_ns = due_ns + LATENCY_NS
                self._exposed.append(CameraFrame(self._count, due_ns, arrives_ns, self._seen()))
        while self._exposed and self._exposed[0].received_ns <= now:
            self.newest = self._exposed.pop(0)
            self._fresh.append(self.newest)

    def _due_ns(self) -> int:
        """When the next frame is due."""
        return self._first_ns + round(self._count * SECOND / CAMERA_HZ)

    def _seen(self) -> tuple[Pose | None, ...]:
        names = self.world.setup.names
        poses = [
            Pose(*map(float, row), **self.standing.get(name, {}))
            for name, row in zip(names, self.world.poses, strict=True)
        ]
        return tuple(
            None if name in self.hidden else pose for name, pose in zip(names, poses, strict=True)
        )


@dataclass
class FakeActuator:
    """Lets the world's robots move; those of a lamp or field (`halts` False) move for ever."""

    world: World
    halts: bool = True
    period_ns: int = SECOND // 40
    failure: str | None = None
    sent: list[Transmission] = field(default_factory=list)
    emergencies: int = 0

    def __enter__(self):
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def check(self) -> Health:
        return Health(facts={"actuator": "fake"})

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        return [RobotStatus(True if self.halts else None)] * len(self.world.moving)

    def send(
        self,
        action: Steer | Turn,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        if isinstance(action, Turn) and not self.halts:
            raise AbortError("cells cannot turn on the spot")
        return self._send(action, tuple(moving))

    def stop(self, emergency: bool = False) -> Transmission:
        self.emergencies += emergency
        return self._send(Stop(), (not self.halts,) * len(self.world.moving))

    def _send(self, action: Action, moving: tuple[bool, ...]) -> Transmission:
        if self.failure is not None:
            raise AbortError(self.failure)
        world = self.world
        setup = world.setup
        world.advance()
        world.moving = tuple(
            was if i in world.deaf else now
            for i, (was, now) in enumerate(zip(world.moving, moving, strict=True))
        )
        match action:
            case Steer(u) | Turn(u):
                world.direction = u
        world.ahead = 0.0 if isinstance(action, Turn) else 1.0
        let = np.array(moving, dtype=float)
        speed = setup.speed * let * world.ahead
        sine = np.sin(world.direction - world.poses[:, 2])
        turning = setup.a * sine * let
        wheels = (None, None)
        if setup.wheel_radius is not None:
            straight_left, straight_right = wheel_speeds(sine, setup.a, speed, 0.0)
            apart = turning * setup.wheel_radius
            wheels = (straight_left - apart, straight_right + apart)
        delivered = (True,) * len(moving) if isinstance(action, Stop) else moving
        now_ns = world.clock.now()
        transmission = Transmission(
            action, now_ns, delivered, *wheels, speed=speed, turning=turning
        )
        self.sent.append(transmission)
        return transmission


@dataclass
class FakeLab:
    """A lab plant between a fake camera and a fake actuator."""

    plant: LabPlant
    camera: FakeCamera
    actuator: FakeActuator
    world: World
    clock: SteppedClock
    supervision: LabSupervision


def fake_lab(
    setup: Setup,
    limits: LabLimits | None = None,
    checks_of: ChecksOf = robot_checks,
    **actuator: object,
) -> FakeLab:
    clock = SteppedClock()
    world = World(setup, clock)
    camera = FakeCamera(world)
    fake_actuator = FakeActuator(world, **actuator)
    supervision = LabSupervision()
    rig = Rig(
        camera,
        fake_actuator,
        limits or LabLimits(),
        setup,
        clock,
        supervision.emergency,
        threaded=False,
        checks_of=checks_of,
    )
    clock.steps.append(rig.loop.step)
    plant = LabPlant(rig, supervision)
    return FakeLab(plant, camera, fake_actuator, world, clock, supervision)
