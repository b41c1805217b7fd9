"""The preflight check: robots tracked, on their starts and answering; camera frames fresh."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.commands import EMULATED, RobotStatus
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame
from tetractl.core.protocols import LabSupervision
from tetractl.lab.pose_filter import AcceptedFrame
from tetractl.lab.rest_check import moving_robots
from tetractl.lab.rig import Rig

POLL_S = 1.0
WATCHED = 60  # camera frames
WATCH_NS = SECOND
LOOK_NS = SECOND // 100
PLACES_NS = SECOND // 5  # how often the robots' positions are checked
GRACE_S = 1.0  # least time to wait, since frames are missing occasionally
SILENCE_S = 0.5  # a camera silent for this long ends the wait, or longer if the spec bears it


@dataclass(frozen=True, slots=True)
class RobotFinding:
    """How one robot stands: distance to its start [mm] and heading off [rad], None untracked.

    `misplaced` says how it is off its start, "" if it is not or is not tracked, and `untracked`
    that it is not tracked and why, "" if it is.
    """

    name: str
    off_mm: float | None
    off_heading: float | None
    misplaced: str
    untracked: str
    status: RobotStatus

    @property
    def tracked(self) -> bool:
        """Whether the camera sees the robot."""
        return self.off_mm is not None

    @property
    def problems(self) -> tuple[str, ...]:
        """What keeps the robot from starting, apart from its position."""
        return (*((self.untracked,) if self.untracked else ()), *self.status.problems)


@dataclass(frozen=True, slots=True)
class Preflight:
    """The result of a preflight.
    `latency_ms` (median, greatest) is the age of frames on arrival, None if the camera does not
    report it. `problems` keep a run from starting, `warnings` do not; `facts` are the devices' own,
    `questions` what a person, if there is one, has to agree to.
    """

    robots: tuple[RobotFinding, ...]
    latency_ms: tuple[float, float] | None
    camera_rate_hz: float | None
    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    facts: Mapping[str, str]
    questions: tuple[str, ...] = ()

    @property
    def all_problems(self) -> tuple[str, ...]:
        """Everything that keeps a run from starting, apart from the robots' positions."""
        return (*self.problems, *(p for robot in self.robots for p in robot.problems))

    @property
    def misplaced(self) -> tuple[str, ...]:
        """Tracked robots that are not on their starts, one line each."""
        return tuple(robot.misplaced for robot in self.robots if robot.misplaced)

    @property
    def ready(self) -> bool:
        """Whether a run could start."""
        return not (self.all_problems or self.misplaced)

    @property
    def all_warnings(self) -> tuple[str, ...]:
        """Everything that is wrong but does not keep a run from starting."""
        robots = (w for robot in self.robots for w in robot.status.warnings)
        return (*self.warnings, *self.questions, *robots)


def inspect(rig: Rig) -> Preflight:
    """Watch some camera frames, ask both devices and poll the robots; moves nothing."""
    statuses = rig.actuator.poll(POLL_S)
    outdated = rig.guard.outdated
    seen = _watch(rig)
    outdated = rig.guard.outdated - outdated
    camera, actuator = rig.camera.check(), rig.actuator.check()
    newest = rig.frames.newest
    problems = [*camera.problems, *actuator.problems]
    if newest is not None and newest.frame.fault:
        problems.append(newest.frame.fault)
    if not seen:
        problems.append(rig.guard.no_frame(rig.silent_ns()))
    latency_ms = _latency_ms(seen)
    if latency_ms is not None and latency_ms[0] > 1000 * rig.limits.latency:
        problems.append(f"frames are {latency_ms[0]:.0f} ms old when they come")
    if newest is not None and rig.actuator.halts:  # cells are always present
        problems += _strangers(rig, newest.frame)
    robots = tuple(_robot(rig, i, newest, status) for i, status in enumerate(statuses))
    devices = {"camera": camera, "actuator": actuator}
    emulated = ", ".join(name for name, health in devices.items() if health.emulated)
    return Preflight(
        robots,
        latency_ms,
        _rate_hz(seen),
        tuple(problems),
        (*camera.warnings, *actuator.warnings, *((dropped(outdated),) if outdated else ())),
        {**camera.facts, **actuator.facts} | ({EMULATED: emulated} if emulated else {}),
        (*camera.questions, *actuator.questions),
    )


def unplaced(rig: Rig) -> list[str]:
    """Return one line per robot that is not seen on its start now."""
    newest, found = rig.frames.newest, []
    for i, name in enumerate(rig.setup.names):
        off_mm, off_heading = _off(rig, i, newest)
        line = rig.not_tracked(i) if off_mm is None else _misplaced(rig, name, off_mm, off_heading)
        if line:
            found.append(line)
    return found


def dropped(outdated: int) -> str:
    """Return a warning about a number of frames that were not exposed after those before them."""
    return f"camera frames dropped because later ones had come: {outdated}"


def _robot(rig: Rig, i: int, frame: AcceptedFrame | None, status: RobotStatus) -> RobotFinding:
    name = rig.setup.names[i]
    off_mm, off_heading = _off(rig, i, frame)
    misplaced = "" if off_mm is None else _misplaced(rig, name, off_mm, off_heading)
    untracked = rig.not_tracked(i) if off_mm is None else ""
    return RobotFinding(name, off_mm, off_heading, misplaced, untracked, status)


def _misplaced(rig: Rig, name: str, off_mm: float, off_heading: float | None) -> str:
    if off_mm > rig.limits.start_mm:
        return f"{name} is {off_mm:.0f} mm from its start"
    if off_heading is not None and abs(off_heading) > rig.limits.start_heading:
        return f"{name} is turned by {off_heading:+.2f} rad from its start heading"
    return ""


def _off(rig: Rig, i: int, frame: AcceptedFrame | None) -> tuple[float | None, float | None]:
    """Return how far a robot is from its start: [mm] and [rad], None if it is not tracked."""
    pose = frame.pose(i) if frame is not None else None
    if pose is None:
        return None, None
    starts = rig.setup.starts
    off = math.hypot(pose.x - starts.x[i], pose.y - starts.y[i])
    return off * rig.mm, math.remainder(pose.heading - starts.heading[i], math.tau)


def _strangers(rig: Rig, frame: CameraFrame) -> list[str]:
    inside = [pose for pose in frame.strangers if rig.setup.arena.contains(pose.x, pose.y)]
    return [f"something else stands in the arena at {p.x:.0f}, {p.y:.0f}" for p in inside]


def _watch(rig: Rig) -> list[CameraFrame]:
    """Return the next frames: `WATCHED` of them, or as many as come before the camera is silent."""
    clock, frames, first = rig.clock, rig.frames, rig.frames.count
    began = heard = clock.now()
    silence = round(rig.limits.stream_lost * SECOND)
    count = first
    while count - first < WATCHED and clock.now() - began < WATCH_NS:
        clock.sleep_until(clock.now() + LOOK_NS)
        before, count = count, frames.count
        if count > before:
            heard = clock.now()
        elif clock.now() - heard > silence:
            break
    seen, _ = frames.since(first)
    return [accepted.frame for accepted in seen]


def _latency_ms(seen: Sequence[CameraFrame]) -> tuple[float, float] | None:
    """Return the median and greatest age of frames; without clocks in common all are 0."""
    ages = sorted(frame.received_ns - frame.sampled_ns for frame in seen)
    if not ages or not ages[-1]:
        return None
    return ages[len(ages) // 2] / 1e6, ages[-1] / 1e6


def _rate_hz(seen: Sequence[CameraFrame]) -> float | None:
    if len(seen) < 2 or seen[-1].received_ns <= seen[0].received_ns:
        return None
    span = seen[-1].received_ns - seen[0].received_ns
    return (seen[-1].number - seen[0].number) * SECOND / span


def wait_until_ready(rig: Rig, supervision: LabSupervision) -> Preflight:
    """Return once there is no problem, every robot is on its start and the operator, if there is
    one, agrees.

    Robots that can stand still must do so. Robots that are carried may be off and out
    of sight for a while: without a person, `limits.placing` is how long. AbortError says what is
    wrong and how far each robot is off; KeyboardInterrupt if the operator gives up waiting.
    """
    prompt, clock = supervision.prompt, rig.clock
    limit_ns = round(max(rig.limits.placing, GRACE_S) * SECOND)
    began = clock.now()
    while True:
        findings: Preflight | None = None
        lines = unplaced(rig) or (moving_robots(rig) if rig.actuator.halts else [])
        if lines:  # why a robot is not tracked is reported before the fact
            lines = [*rig.camera.check().problems, *lines]
        if not lines:
            findings = inspect(rig)
            lines = list(dict.fromkeys((*findings.all_problems, *unplaced(rig))))
        if prompt is not None:
            prompt.place(lines, findings.questions if findings else ())
        if findings is not None and not lines and (prompt is None or prompt.go()):
            return findings
        if supervision.emergency.is_set():
            raise AbortError("emergency stop by the operator")
        if supervision.cancelled():
            raise KeyboardInterrupt
        _check_stream(rig)
        if prompt is None and clock.now() - began >= limit_ns:
            problems = (findings or inspect(rig)).all_problems
            raise AbortError(
                "; ".join(dict.fromkeys((*problems, *lines))),
                "see `tetractl lab check`; limits.placing waits for robots to be placed",
            )
        clock.sleep_until(clock.now() + PLACES_NS)


def _check_stream(rig: Rig) -> None:
    silent_ns = rig.silent_ns()
    if silent_ns > max(rig.limits.stream_lost, SILENCE_S) * SECOND:
        raise AbortError(rig.guard.no_frame(silent_ns))
