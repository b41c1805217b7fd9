"""The preflight checks, without moving a robot, whether a run on real robots can start.

`inspect` takes the next FRAMES_CHECKED camera frames, and checks:

    frames    Do frames arrive? Is the median of their ages on arrival, counted from the exposure,
              at most `latency` [s]? (Only a warning: is their rate below RATE_FRACTION_MIN
              of the camera's rate?)
    robots    Is each robot tracked, and at most `start_mm` [mm] and `start_heading` [rad] from its
              start? Does it answer, and what does it report?
    arena     If robots can stand still: do they, and is nothing else in the arena?
    devices   What do the camera and the actuator report about themselves?

`inspect_lab` does this once. If one device cannot be opened, it still checks the other. While
people place the robots, `wait_until_ready` checks the newest frame every 0.2 s, and inspects once
when all robots are on their starts.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from tetractl.core.clock import SECOND
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame
from tetractl.core.protocols import Health, LabSupervision, RobotStatus
from tetractl.core.trial import EMULATED_DEVICES_FACT
from tetractl.lab.camera_stream import compute_rate_hz
from tetractl.lab.frames import AcceptedFrame, accept_all_poses
from tetractl.lab.rest_check import describe_drifting_robots, describe_moving_robots
from tetractl.lab.rig import Rig

FRAMES_CHECKED = 60
"""Number of camera frames that are checked, within at most one second."""
RATE_FRACTION_MIN = 0.8
"""Fraction of the camera's own rate below which the rate of frames causes a warning."""
NOT_POLLED = RobotStatus(None)
QUARTER_TURN = math.pi / 2
"""A quarter turn [rad]."""


@dataclass(frozen=True, slots=True)
class RobotFinding:
    """The state of one robot, found in the checks before a run.

    Attributes:
        name: The robot.
        off_mm: Distance from its start [mm]. None if it is untracked.
        off_heading: Its heading minus its start heading [rad]. None if it is untracked.
        misplaced: How far the robot is from its start. Empty if it is there, or untracked.
        untracked: Why the robot is untracked. Empty if it is tracked.
        status: Its answer to a poll.
    """

    name: str
    off_mm: float | None
    off_heading: float | None
    misplaced: str
    untracked: str
    status: RobotStatus

    @property
    def tracked(self) -> bool:
        """Whether the camera tracked the robot at the time of the check."""
        return self.off_mm is not None

    @property
    def problems(self) -> tuple[str, ...]:
        """Problems that prevent the robot from starting, one line each.

        A wrong position is not among them.
        """
        return (*((self.untracked,) if self.untracked else ()), *self.status.problems)


@dataclass(frozen=True, slots=True)
class Preflight:
    """The findings of a preflight, which checks whether a run can start.

    Attributes:
        robots: The state of each robot.
        latency_ms: Median and maximum age of frames on arrival [ms]. None if the camera does not
            report it.
        camera_rate_hz: Rate of frames [Hz]. None if unknown.
        problems: Reasons that prevent a run from starting, one line each.
        warnings: Things that the operator should know, one line each.
        facts: Facts about the devices.
        questions: Questions that the operator has to confirm, one line each.
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
        """Problems that prevent a run from starting, one line each, without misplaced robots."""
        return (*self.problems, *(p for robot in self.robots for p in robot.problems))

    @property
    def misplaced(self) -> tuple[str, ...]:
        """One line for each tracked robot that is not on its start."""
        return tuple(robot.misplaced for robot in self.robots if robot.misplaced)

    @property
    def can_start(self) -> bool:
        """Whether no check has found a problem, and every tracked robot is on its start."""
        return not (self.all_problems or self.misplaced)

    @property
    def all_warnings(self) -> tuple[str, ...]:
        """All warnings about the run, the devices and the robots, and the operator's questions."""
        robots = (w for robot in self.robots for w in robot.status.warnings)
        return (*self.warnings, *self.questions, *robots)


def inspect_lab(
    rig: Rig, add_findings: Callable[[Preflight], Preflight] = lambda findings: findings
) -> Preflight:
    """Open a lab, check whether a run could start, and close the lab.

    If a device cannot be opened, that is reported together with the problems of the other device,
    so that the operator learns everything at once.

    Args:
        rig: The lab, which has not been opened before.
        add_findings: Called with the findings while both devices are open. It can add findings of
            its own, and returns all of them.
    """
    try:
        failures = rig.open_devices()
        if not failures:
            with rig:
                return add_findings(inspect(rig))
        return _inspect_opened(rig, failures)
    finally:
        rig.close()


def _inspect_opened(rig: Rig, failures: Mapping[str, AbortError]) -> Preflight:
    """Inspect the devices of a lab that could be opened; report the `failures` of the others."""
    problems = [
        f"{failure.message} ({failure.hint})" if failure.hint else failure.message
        for failure in failures.values()
    ]
    names = rig.setup.names
    robots = [RobotFinding(name, None, None, "", "", NOT_POLLED) for name in names]
    health = Health()
    if "actuator" not in failures:
        health = rig.actuator.check()
        statuses = rig.actuator.poll(1.0)
        robots = [replace(robots[i], status=status) for i, status in enumerate(statuses)]
    elif "camera" not in failures:
        health = rig.camera.check()
        newest = rig.loop.frames.newest
        frames = [] if newest else rig.camera.frames()  # which no guard has checked
        newest = accept_all_poses(frames[-1]) if frames else newest
        robots = [_check_robot(rig, i, newest) for i in range(len(names))]
    return Preflight(
        robots=tuple(robots),
        latency_ms=None,
        camera_rate_hz=None,
        problems=(*problems, *health.problems),
        warnings=health.warnings,
        facts=health.facts,
        questions=health.questions,
    )


def inspect(rig: Rig) -> Preflight:
    """Check the next camera frames, both devices and the robots' answers.

    No robot is moved. The lab must be open. This takes up to about two seconds.
    """
    statuses = rig.actuator.poll(1.0)
    dropped_before = rig.loop.guard.dropped_frame_count
    new_frames = _watch_frames(rig)
    n_dropped = rig.loop.guard.dropped_frame_count - dropped_before
    camera = rig.camera.check()
    actuator = rig.actuator.check()
    newest = rig.loop.frames.newest
    problems = [*camera.problems, *actuator.problems]
    if newest is not None and newest.frame.fault:
        problems.append(newest.frame.fault)
    if not new_frames:
        problems.append(rig.loop.guard.explain_missing_frames(rig.measure_silence_ns()))
    latency_ms = _compute_latency_ms(new_frames)
    measured_hz = compute_rate_hz(
        [frame.number for frame in new_frames], [frame.received_ns for frame in new_frames]
    )
    own_hz = rig.setup.sight.rate_hz
    is_slow = measured_hz is not None and measured_hz < RATE_FRACTION_MIN * own_hz
    warnings = [*camera.warnings, *actuator.warnings, *describe_quarter_turns(rig, newest)]
    if is_slow:
        warnings.append(
            f"the camera sends only {measured_hz:.0f} frames per second instead of {own_hz:.0f}"
        )
    if n_dropped:
        warnings.append(describe_dropped_frames(n_dropped))
    if latency_ms is not None and latency_ms[0] > 1000 * rig.limits.latency:
        problems.append(
            f"camera frames are {latency_ms[0]:.0f} ms old on arrival, but limits.latency allows "
            f"only {1000 * rig.limits.latency:g} ms"
        )
    if newest is not None and rig.actuator.halts:  # a dish always shows other cells
        problems += _describe_unknown_objects(rig, newest.frame)
        problems += describe_drifting_robots(rig)
    robots = tuple(_check_robot(rig, i, newest, status) for i, status in enumerate(statuses))
    emulated = ", ".join(rig.list_emulated(camera, actuator))
    return Preflight(
        robots,
        latency_ms,
        measured_hz,
        tuple(problems),
        tuple(warnings),
        {**camera.facts, **actuator.facts}
        | ({EMULATED_DEVICES_FACT: emulated} if emulated else {}),
        (*camera.questions, *actuator.questions),
    )


def describe_unplaced(rig: Rig) -> list[str]:
    """Describe each robot that is untracked or not on its start, in one line.

    A further line is added if all robots seem to be turned by the same number of quarter turns.
    """
    newest = rig.loop.frames.newest
    robots = (_check_robot(rig, i, newest) for i in range(len(rig.setup.names)))
    lines = [line for robot in robots if (line := robot.untracked or robot.misplaced)]
    return [*lines, *describe_quarter_turns(rig, newest)]


def describe_quarter_turns(rig: Rig, frame: AcceptedFrame | None) -> list[str]:
    """Report tags or bodies that are mounted with a wrong orientation.

    If all robots are on their starts, and all headings are off by the same number of quarter
    turns, it is the tags or bodies that are mounted the wrong way, not the robots. Robots that may
    start at any heading, such as cells that a trial finds, are not checked. The result is one
    line, or empty.
    """
    if rig.limits.start_heading >= QUARTER_TURN:
        return []
    robots = [_check_robot(rig, i, frame) for i in range(len(rig.setup.names))]
    heading_errors = [robot.off_heading for robot in robots if robot.off_heading is not None]
    on_start = [
        robot.off_mm is not None and robot.off_mm <= rig.limits.start_mm for robot in robots
    ]
    if not all(on_start):
        return []
    n_quarters = round(heading_errors[0] / QUARTER_TURN)
    error_max = min(rig.limits.start_heading, QUARTER_TURN / 4)
    errors = [
        abs(math.remainder(turn - n_quarters * QUARTER_TURN, math.tau)) for turn in heading_errors
    ]
    if n_quarters == 0 or max(errors) > error_max:
        return []
    degrees = "180" if abs(n_quarters) == 2 else f"{90 * n_quarters:+d}"
    subject = "all robots are" if len(robots) > 1 else f"{robots[0].name} is"
    return [
        f"{subject} turned by {degrees} degrees from the start heading: does each tag or body "
        "point to the robot's front? (The top edge of an AprilTag belongs on the robot's left.)"
    ]


def describe_dropped_frames(n_dropped: int) -> str:
    """Create a warning that a number of frames were dropped, because newer frames came first."""
    if n_dropped == 1:
        return "1 camera frame was dropped, because a later frame had already arrived"
    return f"{n_dropped} camera frames were dropped, because later frames had already arrived"


def _check_robot(
    rig: Rig, index: int, frame: AcceptedFrame | None, status: RobotStatus = NOT_POLLED
) -> RobotFinding:
    name = rig.setup.names[index]
    starts = rig.setup.starts
    limits = rig.limits
    pose = frame.pose(index) if frame is not None else None
    if pose is None:
        return RobotFinding(name, None, None, "", rig.describe_untracked(index), status)
    off_mm = math.hypot(pose.x - starts.x[index], pose.y - starts.y[index]) * rig.mm_per_unit
    heading_error = math.remainder(pose.heading - starts.heading[index], math.tau)
    misplaced = ""
    if off_mm > limits.start_mm:
        misplaced = (
            f"{name} is {off_mm:.0f} mm from its start (at most {limits.start_mm:g} mm are allowed)"
        )
    elif abs(heading_error) > limits.start_heading:
        misplaced = (
            f"{name} is turned by {heading_error:+.2f} rad from its start heading "
            f"(at most {limits.start_heading:g} rad are allowed)"
        )
    return RobotFinding(name, off_mm, heading_error, misplaced, "", status)


def _describe_unknown_objects(rig: Rig, frame: CameraFrame) -> list[str]:
    """Describe each unknown object that the camera sees in the arena, in one line."""
    inside = [pose for pose in frame.unknown_objects if rig.setup.arena.contains(pose.x, pose.y)]
    unit = rig.setup.unit
    return [
        f"an unknown object is in the arena at {p.x:.0f}, {p.y:.0f} {unit}: remove it"
        for p in inside
    ]


def _watch_frames(rig: Rig) -> list[CameraFrame]:
    """Return the next `FRAMES_CHECKED` frames, or fewer.

    There are fewer if they take more than a second, or if the camera stops sending.
    """
    clock = rig.clock
    frames = rig.loop.frames
    first_count = rig.loop.frames.count
    start_ns = received_ns = clock.now()
    silence_max_ns = round(rig.limits.stream_lost * SECOND)
    count = first_count
    while count - first_count < FRAMES_CHECKED and clock.now() - start_ns < SECOND:
        clock.sleep_until(clock.now() + SECOND // 100)
        previous_count = count
        count = frames.count
        if count > previous_count:
            received_ns = clock.now()
        elif clock.now() - received_ns > silence_max_ns:
            break
    frames_since, _ = frames.since(first_count)
    return [accepted.frame for accepted in frames_since]


def _compute_latency_ms(frames: Sequence[CameraFrame]) -> tuple[float, float] | None:
    """Compute the median and the maximum age of frames on arrival [ms].

    The result is None if there are no frames, or if the camera does not report when they were
    exposed.
    """
    ages_ns = sorted(frame.received_ns - frame.sampled_ns for frame in frames)
    if not ages_ns or not ages_ns[-1]:
        return None
    return ages_ns[len(ages_ns) // 2] / 1e6, ages_ns[-1] / 1e6


def wait_until_ready(rig: Rig, supervision: LabSupervision) -> Preflight:
    """Wait until no problem is left, every robot is on its start, and the operator agrees.

    Robots that can stand still must do so. While people carry robots, these may be untracked or
    away from their starts. Without an operator, this lasts at most `limits.placing`.

    Raises:
        AbortError: If the time is over. The error lists the problems and each robot's distance from
            its start.
        KeyboardInterrupt: If the operator gives up.
    """
    prompt = supervision.prompt
    clock = rig.clock
    # frames are missing occasionally, so a robot has at least 1 s
    limit_ns = round(max(rig.limits.placing, 1.0) * SECOND)
    start_ns = clock.now()
    while True:
        findings: Preflight | None = None
        lines = describe_unplaced(rig) or (
            describe_moving_robots(rig) if rig.actuator.halts else []
        )
        if lines:  # the reason why a robot is not tracked is reported first
            lines = [*rig.camera.check().problems, *lines]
        if not lines:
            findings = inspect(rig)
            lines = list(dict.fromkeys((*findings.all_problems, *describe_unplaced(rig))))
        if prompt is not None:
            prompt.place(lines, findings.questions if findings else ())
        if findings is not None and not lines and (prompt is None or prompt.go()):
            return findings
        if supervision.emergency.is_set():
            raise AbortError("emergency stop by the operator")
        if supervision.cancelled():
            raise KeyboardInterrupt
        _check_stream(rig)
        if prompt is None and clock.now() - start_ns >= limit_ns:
            problems = (findings or inspect(rig)).all_problems
            raise AbortError(
                "; ".join(dict.fromkeys((*problems, *lines))),
                "run `tetractl lab check` to find the cause; with a larger limits.placing, the run "
                "waits longer for the robots to be placed",
            )
        clock.sleep_until(clock.now() + SECOND // 5)


def _check_stream(rig: Rig) -> None:
    """Raise AbortError if the camera reports a fault or has stopped sending frames."""
    silent_ns = rig.measure_silence_ns()
    newest = rig.loop.frames.newest
    if newest is not None and newest.frame.fault:
        raise AbortError(newest.frame.fault)
    if silent_ns > max(rig.limits.stream_lost, 0.5) * SECOND:
        raise AbortError(rig.loop.guard.explain_missing_frames(silent_ns))
