"""Cameras that show robots elsewhere than they are, in the emulated lab in virtual time."""

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from support.bench_agreement import lab_spec, lab_trial
from support.virtual_lab import VirtualLab

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.core.trial import Result
from tetractl.lab.guard_records import GuardState

CAMERA_HZ = 120.0
NOISE = {"noise_mm": 0.3, "noise_rad": 0.004}  # of a real capture
WHEEL_M = 0.04  # from a wheel to the robot's centre
KINDS = ("frozen", "along", "against", "sideways", "heading", "curve", "turn", "slip")
NUMBERS = "numbers"
PUSH_S = 0.2
STEP_M = 0.004
STEPS_S = 0.5
CAMERA = ("origin", "scale", "rotation")


@dataclass
class Ghost:
    """What a camera shows of robots `who` from `at_s` after the first command on, or always (-inf).

    `frozen` poses repeat. A ghost goes away from its robot at a speed [m/s]: `along` its heading,
    `against` it or `sideways`. The `heading` shown turns by the speed at the wheels, or the whole
    ghost does, and drives on as a robot does (`curve`); a `turn` is a curve whose speed is in
    rad/s, and a `slip` turns only while its robot drives. A `push` moves it by `speed` [m] within
    PUSH_S, and `steps` by 4 mm each half second.
    Of the whole picture, the `origin` moves [m/s], the `scale` grows [1/s], or it turns
    about its origin (`rotation`) [rad/s]. Two robots that have exchanged their `numbers` are shown
    where they are, but each does what the other is commanded.
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
        self._paths = {}
        self._shown = {}
        self._last = {}
        if self.kind == NUMBERS:
            side = lab.emulation.actuator
            side.swap_numbers(*(side.robots[i] for i in self.who))
        motive = lab.emulation.camera
        motive._expose = self._exposed(motive._expose)
        lab.clock.steps.append(self._watch)

    def _exposed(self, expose):
        """What the cameras report, of bodies that are put where the ghost is."""

        def exposed():
            true = tuple(Pose(robot.x, robot.y, robot.heading) for robot in self.lab.robots)
            shown = self._show(true)
            bodies = self.lab.emulation.camera.tracked
            for body, pose, now in zip(bodies, true, shown, strict=True):
                body.shift = complex(now.x - pose.x, now.y - pose.y)
                body.turned = now.heading - pose.heading
            for i in self._shown if self.kind == "frozen" else ():
                bodies[i].repeats = True
            return expose()

        return exposed

    @property
    def _since_s(self) -> float:
        return (self.lab.clock.timeline.now_ns - (self._began or 0)) / SECOND

    def _show(self, poses: tuple[Pose, ...]) -> tuple[Pose, ...]:
        now = self.lab.clock.timeline.now_ns
        last = self.lab.plant.rig.loop.last
        if self._began is None and self.at_s == -math.inf:
            self._began = now
        elif self._began is None and last is not None and last.direction is not None:
            self._began = now + round(self.at_s * SECOND)
        dt = (now - self._then) / SECOND
        self._then = now
        if self._began is None or now < self._began:
            self._last = dict(enumerate(poses))
            return poses
        if self.kind != "slip" or not self.lab.robots[self.who[0]].standing:
            self._turned += (
                self.speed / (WHEEL_M if self.kind in ("heading", "curve") else 1.0) * dt
            )
        shown = list(poses)
        for i in self.who:
            shown[i] = self._ghost(i, poses[i], 1000 * self.speed * dt)
            self._shown[i] = shown[i]
            self._last[i] = poses[i]
        return tuple(shown)

    def _ghost(self, i: int, pose: Pose, step: float) -> Pose:
        before = self._last.get(i, pose)
        if self.kind == NUMBERS:
            return pose
        if self.kind == "frozen":
            return self._shown.get(i, before)
        if self.kind == "heading":
            return Pose(pose.x, pose.y, pose.heading + self._turned)
        if self.kind in ("push", "steps"):
            share = min(1.0, self._since_s / PUSH_S)
            way = self.speed * share if self.kind == "push" else STEP_M * (self._since_s // STEPS_S)
            return Pose(pose.x + 600 * way, pose.y + 800 * way, pose.heading)
        if self.kind in CAMERA:
            grown = self._turned * (self.kind == "scale")
            turn = self._turned
            turn, way = turn * (self.kind == "rotation"), 1000 * turn * (self.kind == "origin")
            z = complex(pose.x, pose.y) * cmath.rect(1.0 + grown, turn) + way * (0.6 + 0.8j)
            return Pose(z.real, z.imag, pose.heading + turn)
        dx, dy = self._paths.get(i, (0.0, 0.0))
        if self.kind in ("curve", "turn", "slip"):
            x = pose.x - before.x
            y = pose.y - before.y
            cos = math.cos(self._turned)
            sin = math.sin(self._turned)
            self._paths[i] = dx + cos * x - sin * y - x, dy + sin * x + cos * y - y
            dx, dy = self._paths[i]
            return Pose(pose.x + dx, pose.y + dy, pose.heading + self._turned)
        angle = {"along": 0.0, "against": math.pi, "sideways": math.pi / 2}[self.kind]
        course = self.lab.robots[i].heading + angle
        self._paths[i] = dx + step * math.cos(course), dy + step * math.sin(course)
        dx, dy = self._paths[i]
        return Pose(pose.x + dx, pose.y + dy, pose.heading)

    def _watch(self) -> None:
        if self._began is None or self.lab.clock.timeline.now_ns < self._began:
            self._from = [(robot.x, robot.y) for robot in self.lab.robots]
            return
        guard = self.lab.plant.rig.guard
        last = self.lab.plant.rig.loop.last
        if self._since_s > self.limit_s and guard.state is not GuardState.ABORT:
            guard.abort("not noticed")
        if last and not math.isfinite(self.held_s) and not any(last.moving[i] for i in self.who):
            self.held_s = self._since_s
            self.off_mm = max(self._off(i) for i in self.who)
        if not math.isfinite(self.rest_s):
            ways = zip(self._from, self.lab.robots, strict=True)
            self.driven_mm = max(math.hypot(r.x - x, r.y - y) for (x, y), r in ways)
            stopped = guard.state is GuardState.ABORT
            if stopped and all(robot.standing for robot in self.lab.robots):
                self.rest_s = self._since_s
        elif frame := self.lab.plant.rig.frames.newest:
            self.late += [frame.fresh[i] for i in self.who]

    def _off(self, i: int) -> float:
        robot = self.lab.robots[i]
        shown = self._shown[i]
        return math.hypot(shown.x - robot.x, shown.y - robot.y)


def slow_radio(lab: VirtualLab, delay_s: float) -> None:
    """Let every transmission of a run arrive so much later."""
    radio = lab.emulation.actuator.radio
    take = radio._take_air

    def late(size):
        running = lab.plant.rig.guard.state in (GuardState.RUN, GuardState.HOLD)
        return take(size) + round(running * delay_s * SECOND)

    radio._take_air = late


def trial_of(
    change: Callable[[VirtualLab], None],
    trial: int = 0,
    rate_hz: float = CAMERA_HZ,
    robots_of: int | None = None,
) -> Result:
    """Run a trial of the lab changed by `change`, with noisy frames and wheels up to 10 % off."""
    spec = lab_spec("controller.optimizer.rounds=2")
    result = lab_trial(spec, trial, 0.1, NOISE | {"rate": rate_hz}, change, robots_of).result
    assert result is not None
    return result
