"""What must hold before robots move: everybody there, on their starts, answering; cameras fresh."""

import math
from dataclasses import dataclass, field

from tetractl.core.clock import SECOND
from tetractl.core.poses import CameraFrame
from tetractl.lab.actuators.m3pi.protocols import Answer
from tetractl.lab.rig import Session, heading_gap

POLL_S = 1.0
LATENCY_FRAMES = 60


@dataclass(frozen=True, slots=True)
class RobotFinding:
    """How one robot stands: distance to its start [mm] and heading off [rad], None untracked."""

    name: str
    off_mm: float | None
    off_heading: float | None
    placed: bool
    answer: Answer | None
    problems: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    @property
    def battery_v(self) -> float | None:
        """Battery voltage, None where unknown."""
        return self.answer.battery_mv / 1000 if self.answer and self.answer.battery_mv else None


@dataclass(frozen=True, slots=True)
class Findings:
    """What a preflight found. `latency_ms` (median, greatest) is the age of frames on arrival."""

    robots: tuple[RobotFinding, ...]
    latency_ms: tuple[float, float] | None
    camera_rate_hz: float | None
    round_trip_ms: float | None
    problems: tuple[str, ...] = field(default=())
    warnings: tuple[str, ...] = field(default=())

    @property
    def all_problems(self) -> tuple[str, ...]:
        """Everything that keeps a run from starting."""
        return (*self.problems, *(p for robot in self.robots for p in robot.problems))

    @property
    def all_warnings(self) -> tuple[str, ...]:
        """Everything to be told about that does not."""
        return (*self.warnings, *(w for robot in self.robots for w in robot.warnings))


def inspect(session: Session, answers: list[Answer | None]) -> Findings:
    """Look at everything but the placing of the robots as a problem; see `unplaced`."""
    latencies, rate, newest = _watch(session)
    problems: list[str] = []
    warnings: list[str] = []
    limits = session.lab.limits
    names = session.client.stream.missing()
    if session.client.stream.model is not None and names:
        problems.append(f"the cameras know no rigid body {', '.join(map(str, names))}")
    if newest is not None and newest.fault:
        problems.append(newest.fault)
    latency = None
    if latencies:
        latency = latencies[len(latencies) // 2] / 1e6, latencies[-1] / 1e6
        if latency[0] > 1000 * limits.latency:
            problems.append(f"frames are {latency[0]:.0f} ms old when they come")
    else:
        warnings.append("the server does not tell its clock, so the frames' age is not known")
    version = session.client.stream.version
    if version is not None and not version.known:
        warnings.append(f"protocol {version} is newer than those known here; it is read as 4.3")
    if newest is not None:
        problems += _strangers(session, newest)
    robots = tuple(
        _robot(session, i, newest, answers[i]) for i in range(len(session.experiment.robots))
    )
    sync = session.client.stream.sync
    round_trip = sync.round_trip_ns / 1e6 if sync is not None and sync.synced else None
    return Findings(robots, latency, rate, round_trip, tuple(problems), tuple(warnings))


def poll(session: Session) -> list[Answer | None]:
    """Ask every robot for an answer."""
    return session.voice.poll(POLL_S)


def unplaced(session: Session, snapshot: CameraFrame | None) -> list[str]:
    """Return, a line a robot, who does not stand on its start and how far off it is."""
    found: list[str] = []
    limits = session.lab.limits
    for i, robot in enumerate(session.experiment.robots):
        off_mm, off_heading = _off(session, i, snapshot)
        if off_mm is None or off_heading is None:
            found.append(f"{robot.name} is not tracked")
        elif off_mm > limits.start_mm:
            found.append(f"{robot.name} is {off_mm:.0f} mm from its start")
        elif abs(off_heading) > limits.start_heading:
            found.append(f"{robot.name} is turned by {off_heading:+.2f} rad from its start heading")
    return found


def _robot(
    session: Session, i: int, snapshot: CameraFrame | None, answer: Answer | None
) -> RobotFinding:
    name, limits = session.experiment.robots[i].name, session.lab.limits
    off_mm, off_heading = _off(session, i, snapshot)
    problems: list[str] = []
    warnings: list[str] = []
    if off_mm is None:
        problems.append(f"{name} is not tracked")
    if answer is None:
        problems.append(f"{name} does not answer: is it on, and is its index or address right?")
    elif answer.emergency_stopped:
        problems.append(f"{name} is emergency-stopped: switch it off and on again")
    elif answer.battery_mv and answer.battery_mv < 1000 * limits.battery_refuse:
        problems.append(f"{name}'s battery is at {answer.battery_mv / 1000:.2f} V: charge it")
    elif answer.battery_mv and answer.battery_mv < 1000 * limits.battery_warn:
        warnings.append(f"{name}'s battery is at {answer.battery_mv / 1000:.2f} V")
    placed = (
        off_mm is not None
        and off_heading is not None
        and off_mm <= limits.start_mm
        and abs(off_heading) <= limits.start_heading
    )
    return RobotFinding(name, off_mm, off_heading, placed, answer, tuple(problems), tuple(warnings))


def _off(
    session: Session, i: int, snapshot: CameraFrame | None
) -> tuple[float | None, float | None]:
    pose = snapshot.poses[i] if snapshot is not None else None
    if pose is None:
        return None, None
    robot = session.experiment.robots[i]
    off = math.hypot(pose.x - robot.start[0], pose.y - robot.start[1])
    return off * session.mm, heading_gap(pose.heading, robot.heading)


def _strangers(session: Session, snapshot: CameraFrame) -> list[str]:
    arena = session.experiment.arena
    inside = [pose for pose in snapshot.strangers if arena.contains(pose.x, pose.y)]
    return [f"something else stands in the arena at {p.x:.0f}, {p.y:.0f}" for p in inside]


def _watch(session: Session) -> tuple[list[int], float | None, CameraFrame | None]:
    """Look at some frames: sorted ages [ns], frame rate [Hz], the newest."""
    client, clock = session.client, session.clock
    first = newest = client.newest
    ages: list[int] = []
    began = clock.now()
    while newest is not None and len(ages) < LATENCY_FRAMES and clock.now() - began < SECOND:
        following = client.wait_newer(newest.number, session.lab.limits.stream_lost)
        if following is None:
            break
        newest = following
        ages.append(newest.received_ns - newest.sampled_ns)
    rate = None
    if first is not None and newest is not None and newest.received_ns > first.received_ns:
        rate = (newest.number - first.number) * SECOND / (newest.received_ns - first.received_ns)
    synced = client.stream.sync is not None and client.stream.sync.synced
    return sorted(ages) if synced else [], rate, newest
