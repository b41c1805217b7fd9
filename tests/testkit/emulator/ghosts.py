"""Cameras that show robots at false poses, in the emulated lab in virtual time."""

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from testkit.emulator.acting import act
from testkit.emulator.bench_agreement import lab_spec, lab_trial
from testkit.emulator.virtual_lab import VirtualLab
from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.core.trial import Result
from tetractl.lab.guard import GuardState

CAMERA_HZ = 120.0
NOISE = {"noise_mm": 0.3, "noise_rad": 0.004}  # of a real capture
WHEEL_M = 0.04  # from a wheel to the robot's centre
NUMBERS = "numbers"
PUSH_S = 0.2
PUSHED = 0.6 + 0.8j  # the direction in which the origin goes, as do pushes and steps
STEP_M = 0.004
STEPS_S = 0.5
CAMERA = ("origin", "scale", "rotation")
COURSES = {"along": 0.0, "against": math.pi, "sideways": math.pi / 2}  # against the heading [rad]
MM_PER_M = 1000


@dataclass
class Ghost:
    """What a camera shows of robots `who` from `at_s` after the first command on, or always (-inf).

    `frozen` poses repeat. A ghost goes away from its robot at a speed [m/s]: `along` its heading,
    `against` it or `sideways`. The `heading` shown turns by the speed at the wheels, or the whole
    ghost does, and drives on as a robot does (`curve`); a `turn` is a curve whose speed is in
    rad/s, and a `slip` turns only while its robot drives. A `push` moves it by `speed` [m] within
    PUSH_S, and `steps` by 4 mm each half second. Of the whole picture, the `origin` moves [m/s],
    the `scale` grows [1/s], or it turns about its origin (`rotation`) [rad/s]. Two robots that have
    exchanged their `numbers` are shown where they are, but each does what the other is commanded.
    """

    kind: str
    speed: float = 0.0
    who: Sequence[int] = (0,)
    at_s: float = 1.0
    limit_s: float = 5.0  # not noticed by then, the play is ended
    off_mm: float = 0.0  # how far the pose shown was off when all robots were to stop
    driven_mm: float = 0.0  # how far a robot drove from the fault until all stood
    rest_s: float = math.inf  # from the fault until all stood
    held_s: float = math.inf  # from the fault until those shown elsewhere were to stop
    late: list[bool] = field(default_factory=list)  # poses accepted again afterwards

    def haunt(self, lab: VirtualLab) -> None:
        """Show it in a lab that is not open yet."""
        self.lab = lab
        self._then = 0
        self._began: int | None = None
        self._from = [(robot.x, robot.y) for robot in lab.robots]
        self._turned = 0.0
        self._ways = {}
        self._shown = {}
        self._last = {}
        if self.kind == NUMBERS:
            side = lab.emulation.actuator
            first, second = (side.robots[i] for i in self.who)
            index = first.index
            first.renumber(second.index)
            second.renumber(index)
        motive = lab.emulation.camera
        motive._expose_bodies = self._exposed(motive._expose_bodies)
        lab.clock.steps.append(self._watch)

    def _exposed(self, expose):
        """What the cameras report, of bodies that are put where the ghost is."""

        def exposed():
            true_poses = tuple(Pose(robot.x, robot.y, robot.heading) for robot in self.lab.robots)
            ghost_poses = self._show(true_poses)
            bodies = self.lab.emulation.camera.tracked
            for body, true, ghost in zip(bodies, true_poses, ghost_poses, strict=True):
                body.shift_mm = complex(ghost.x - true.x, ghost.y - true.y)
                body.turned_rad = ghost.heading - true.heading
            if self.kind == "frozen":
                acting = self.lab.emulation.camera.acting
                for name in (bodies[i].robot.name for i in self._shown):
                    if not acting.of_kind("repeat", name):
                        act(acting, "repeat", robot=name)
            return expose()

        return exposed

    @property
    def _since_s(self) -> float:
        return (self.lab.emulation.timeline.now_ns - (self._began or 0)) / SECOND

    def _show(self, poses: tuple[Pose, ...]) -> tuple[Pose, ...]:
        """Return the poses that are shown of robots with these, and move the ghosts on."""
        now = self.lab.emulation.timeline.now_ns
        self._begin_when_due(now)
        dt_s = (now - self._then) / SECOND
        self._then = now
        if self._began is None or now < self._began:
            self._last = dict(enumerate(poses))
            return poses
        self._turn_on(dt_s)
        ghost_poses = list(poses)
        for i in self.who:
            ghost_poses[i] = self._ghost(i, poses[i], MM_PER_M * self.speed * dt_s)
            self._shown[i] = ghost_poses[i]
            self._last[i] = poses[i]
        return tuple(ghost_poses)

    def _begin_when_due(self, now: int) -> None:
        """Begin at once, or so long after the first command."""
        if self._began is not None:
            return
        last = self.lab.plant.rig.loop.last_transmission
        if self.at_s == -math.inf:
            self._began = now
        elif last is not None and last.direction is not None:
            self._began = now + round(self.at_s * SECOND)

    def _turn_on(self, dt_s: float) -> None:
        """Let what turns, grows or moves go on: a slip only while its robot drives."""
        if self.kind == "slip" and self.lab.robots[self.who[0]].standing:
            return
        rate = self.speed / WHEEL_M if self.kind in ("heading", "curve") else self.speed
        self._turned += rate * dt_s

    def _ghost(self, i: int, pose: Pose, step_mm: float) -> Pose:
        """Return where robot i is shown, whose ghost goes on by a step if it goes straight."""
        if self.kind == NUMBERS:
            return pose
        if self.kind == "frozen":
            return self._shown.get(i, self._last.get(i, pose))
        if self.kind == "heading":
            return Pose(pose.x, pose.y, pose.heading + self._turned)
        if self.kind == "push":
            return _pushed(pose, self.speed * min(1.0, self._since_s / PUSH_S))
        if self.kind == "steps":
            return _pushed(pose, STEP_M * (self._since_s // STEPS_S))
        if self.kind == "origin":
            return _moved(pose, MM_PER_M * self._turned * PUSHED)
        if self.kind == "scale":
            return Pose(pose.x * (1.0 + self._turned), pose.y * (1.0 + self._turned), pose.heading)
        if self.kind == "rotation":
            turned = complex(pose.x, pose.y) * cmath.rect(1.0, self._turned)
            return Pose(turned.real, turned.imag, pose.heading + self._turned)
        if self.kind in ("curve", "turn", "slip"):
            self._drive_on(i, pose)
            ghost = _moved(pose, self._ways[i])
            return Pose(ghost.x, ghost.y, pose.heading + self._turned)
        course = self.lab.robots[i].heading + COURSES[self.kind]
        self._ways[i] = self._ways.get(i, 0j) + cmath.rect(step_mm, course)
        return _moved(pose, self._ways[i])

    def _drive_on(self, i: int, pose: Pose) -> None:
        """Let a ghost go as its robot went since the last exposure, in its turned course [mm]."""
        before = self._last.get(i, pose)
        x = pose.x - before.x
        y = pose.y - before.y
        cos = math.cos(self._turned)
        sin = math.sin(self._turned)
        way = self._ways.get(i, 0j)
        self._ways[i] = complex(
            way.real + cos * x - sin * y - x,
            way.imag + sin * x + cos * y - y,
        )

    def _watch(self) -> None:
        if self._began is None or self.lab.emulation.timeline.now_ns < self._began:
            self._from = [(robot.x, robot.y) for robot in self.lab.robots]
            return
        guard = self.lab.plant.rig.loop.guard
        last = self.lab.plant.rig.loop.last_transmission
        if self._since_s > self.limit_s and guard.state is not GuardState.ABORT:
            guard.abort("not noticed")
        driven = last and not last.stops and any(last.delivered[i] for i in self.who)
        if last and not math.isfinite(self.held_s) and not driven:
            self.held_s = self._since_s
            self.off_mm = max(self._off(i) for i in self.who)
        if not math.isfinite(self.rest_s):
            ways = zip(self._from, self.lab.robots, strict=True)
            self.driven_mm = max(math.hypot(r.x - x, r.y - y) for (x, y), r in ways)
            stopped = guard.state is GuardState.ABORT
            if stopped and all(robot.standing for robot in self.lab.robots):
                self.rest_s = self._since_s
            return
        frame = self.lab.plant.rig.loop.frames.newest
        if frame:
            self.late += [frame.is_fresh[i] for i in self.who]

    def _off(self, i: int) -> float:
        """Return how far robot i is shown from where it is [mm]."""
        robot = self.lab.robots[i]
        ghost = self._shown[i]
        return math.hypot(ghost.x - robot.x, ghost.y - robot.y)


def _moved(pose: Pose, way: complex) -> Pose:
    return Pose(pose.x + way.real, pose.y + way.imag, pose.heading)


def _pushed(pose: Pose, way_m: float) -> Pose:
    return Pose(pose.x + 600 * way_m, pose.y + 800 * way_m, pose.heading)


def slow_radio(lab: VirtualLab, delay_s: float) -> None:
    """Let every transmission of a run arrive so much later."""
    radio = lab.emulation.actuator.radio
    take = radio._take_air

    def late(size):
        running = lab.plant.rig.loop.guard.state in (GuardState.RUN, GuardState.HOLD)
        return take(size) + round(running * delay_s * SECOND)

    radio._take_air = late


def trial_of(
    change: Callable[[VirtualLab], None],
    trial: int = 0,
    rate_hz: float = CAMERA_HZ,
) -> Result:
    """Run a trial of the lab changed by `change`, with noisy frames and wheels up to 10 % off."""
    spec = lab_spec("controller.optimizer.rounds=2")
    result = lab_trial(spec, trial, 0.1, NOISE | {"rate": rate_hz}, change).result
    assert result is not None
    return result
