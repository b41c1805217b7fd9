"""The guard's kernel: the rules under which robots may move, whatever else the guard checks.

    rule        value                                      limit                what happens beyond
    program     time since this program's last step        `stream_lost`        the run ends
    direction   time since the controller's last one       `silence_ns`         the run ends
    frame       age of the newest camera frame             `stale`              all robots stop
                                                           `stream_lost`        the run ends
    tracking    age of a robot's last accepted pose        UNTRACKED_STOP_S     the robot stops
                                                           `untracked_abort`    the run ends
    speed       distance from an earlier pose              SPEED_FACTOR times   the pose is refused
                                                           the robot's speed
    arena       place after `reaction`, outside            0, if it increases   the run ends
    obstacle    depth now or after `reaction`              0, or its minimum    the run ends
    separation  distance of two robots after `reaction`    `separation_mm`      the run ends

Each rule compares a measured value with a limit in the spec. No rule fits or estimates anything,
and no option switches one off. In each step of the inner loop, `lab.guard` applies all rules. A
rule that ends a run stops all robots for good. The other checks, such as `lab.motion_check` and
`lab.drift_check`, only add reasons to stop. Obstacles are grown by the radius of a body, so they
can be compared with the centres of robots. Lengths are in the spec's length unit. Times are in ns
on the run's clock.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.guard_check import GuardCheck
from tetractl.core.guard_findings import Abort, Excess, Finding, RobotPlace
from tetractl.core.plan import PAUSE_S
from tetractl.core.poses import Pose
from tetractl.core.setup import Bounds
from tetractl.lab.guard_rules import GuardRules
from tetractl.model.motion.wheel_equations import arc_displacement

SPEED_FACTOR = 2.0
"""Multiple of a robot's speed and turning limits above which its pose counts as a jump."""
JUMP_HEADING = 0.7
"""Difference of headings that is always allowed [rad], as `jump_mm` is for positions."""


# ---- fresh: program, direction, frame, tracking ----


@dataclass(slots=True)
class ControlPace:
    """The times of this program's last step and of the controller's last direction.

    The guard uses them to notice that the program or the controller is too slow.

    Attributes:
        last_step_ns: Time of the last step of the inner loop [ns]. None before the first.
        last_direction_ns: Time of the controller's last direction [ns].
        drives_ahead: Whether robots drive. Otherwise they turn on the spot.
        late_steps: Number of late control steps in a row.
        last_late_ns: Time of the last late control step [ns]. None before that.
        has_begun: Whether a run has begun, after which nobody carries robots.
    """

    last_step_ns: int | None = None
    last_direction_ns: int = 0
    drives_ahead: bool = True
    late_steps: int = 0
    last_late_ns: int | None = None
    has_begun: bool = False


def compare_age(
    rule: str, age_ns: float, limit_ns: float, robot: int | None = None
) -> Excess | None:
    """Compare the age of something, such as a frame or a direction, with its limit.

    Args:
        rule: Name of the rule.
        age_ns: The age [ns].
        limit_ns: The limit [ns].
        robot: Index of the robot. None if the rule concerns all.

    Returns:
        The age and its limit. None if the limit is not reached.
    """
    if age_ns < limit_ns:
        return None
    return Excess(rule, age_ns / SECOND, limit_ns / SECOND, "s", robot)


def check_program(rules: GuardRules, pace: ControlPace, now_ns: int) -> Excess | None:
    """Check whether this program was suspended, so that it has decided nothing for too long.

    Args:
        rules: The limits.
        pace: The times of the last step and of the last direction.
        now_ns: The present time [ns].

    Returns:
        The time without a step and its limit. None if it is within the limit.
    """
    age_ns = 0 if pace.last_step_ns is None else now_ns - pace.last_step_ns
    return compare_age("program", age_ns, rules.limits.stream_lost * SECOND)


def check_direction(rules: GuardRules, pace: ControlPace, now_ns: int) -> Excess | None:
    """Check whether robots that drive ahead have had no new direction for too long.

    Args:
        rules: The limits.
        pace: The times of the last step and of the last direction.
        now_ns: The present time [ns].

    Returns:
        The age of the last direction and its limit. None if it is within the limit.
    """
    if not pace.drives_ahead:
        return None
    return compare_age("direction", now_ns - pace.last_direction_ns, rules.silence_ns)


def check_frame_age(rules: GuardRules, frame_ns: int, now_ns: int) -> Excess | None:
    """Check whether the newest camera frame is too old, so that the run has to end.

    Args:
        rules: The limits.
        frame_ns: When the newest frame was exposed [ns].
        now_ns: The present time [ns].

    Returns:
        The age of the frame and its limit. None if it is within the limit.
    """
    return compare_age("frame", now_ns - frame_ns, rules.limits.stream_lost * SECOND)


def check_tracking(rules: GuardRules, robot: int, age_ns: int) -> Excess | None:
    """Check whether a robot's last accepted pose is too old, so that the run has to end.

    Args:
        rules: The limits.
        robot: Index of the robot.
        age_ns: Age of its last accepted pose [ns].

    Returns:
        The age and its limit. None if it is within the limit.
    """
    return compare_age("tracking", age_ns, rules.limits.untracked_abort * SECOND, robot)


def may_move(rules: GuardRules, pace: ControlPace, frame_ns: int, now_ns: int) -> bool:
    """Check whether frames and directions are recent enough for any robot to move in a run.

    If robots turn on the spot, planning may take long. Their last direction is therefore recent
    enough for `PAUSE_S` and the time without directions that the guard allows.

    Args:
        rules: The limits.
        pace: The times of the last step and of the last direction.
        frame_ns: When the newest frame was exposed [ns].
        now_ns: The present time [ns].
    """
    has_recent_frame = now_ns - frame_ns <= rules.limits.stale * SECOND
    plan_wait_max_ns = round(PAUSE_S * SECOND) + rules.silence_ns
    return has_recent_frame and (
        pace.drives_ahead or now_ns - pace.last_direction_ns < plan_wait_max_ns
    )


# ---- speed ----


def check_speed(
    rules: GuardRules, robot: int, earlier: Pose, pose: Pose, dt_ns: int
) -> Excess | None:
    """Check whether a pose is too far from an earlier pose of the same robot.

    Args:
        rules: The limits.
        robot: Index of the robot.
        earlier: The earlier pose.
        pose: The pose.
        dt_ns: Time between the two poses [ns].

    Returns:
        The distance or the angle that is too large, and its limit. None if the robot can have
        moved from the one pose to the other.
    """
    dt_s = dt_ns / SECOND
    reach_max = SPEED_FACTOR * rules.speeds[robot] * dt_s + rules.limits.jump_mm / rules.mm_per_unit
    distance = pose.distance_to(earlier)
    if distance > reach_max:
        return Excess(
            "speed", distance * rules.mm_per_unit, reach_max * rules.mm_per_unit, "mm", robot
        )
    turn_max_rad = SPEED_FACTOR * rules.turning[robot] * dt_s + JUMP_HEADING
    turn_rad = abs(math.remainder(pose.heading - earlier.heading, math.tau))
    if turn_rad > turn_max_rad:
        return Excess("speed", turn_rad, turn_max_rad, "rad", robot)
    return None


# ---- arena, obstacle, separation ----


class PlaceCheck(GuardCheck):
    """A check that ends a run before a robot leaves the arena, or touches an obstacle or a robot.

    A lost robot is assumed to stand at its last pose.
    """

    def __init__(self, rules: GuardRules) -> None:
        self._rules = rules
        self._largest_error = rules.position_error_max
        self._speeds: Sequence[float] = (0.0,) * len(rules.names)  # of the last transmission
        self._turning: Sequence[float] = (0.0,) * len(rules.names)
        self._minimum_depths: dict[int, float] = {}  # each robot's least depth in obstacles so far

    def start(self) -> None:
        """Forget how deep robots were in obstacles, because a new run starts."""
        self._minimum_depths.clear()

    def record_transmission(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float]
    ) -> None:
        """Record a transmission; see `GuardCheck.record_transmission`."""
        self._speeds = speed
        self._turning = turning

    def check_places(self, robots: Sequence[RobotPlace]) -> Iterator[Finding]:
        """Yield an abort for each robot that will leave the arena or touch something.

        Robots are tested where they are and where they would be after their reaction time. A robot
        that is outside the arena may come back. Robots without a pose are left out.
        """
        arena = self._rules.arena
        poses: dict[str, Pose] = {}
        predicted: dict[str, Pose] = {}
        for i, robot in enumerate(robots):
            name = self._rules.names[i]
            pose = robot.pose
            if pose is None:
                continue
            poses[name] = pose
            predicted[name] = drive_ahead(pose, robot.way)
            if distance_outside(arena, predicted[name]) > distance_outside(arena, pose):
                excess = compute_edge_excess(self._rules, i, predicted[name])
                yield Abort(f"{name} is about to leave the arena", excess=excess)
            excess = self.check_obstacles(i, pose)
            if excess is not None:
                yield Abort(f"{name} is about to enter an obstacle", excess=excess)
        yield from find_too_close(poses, predicted, self._rules)

    def check_obstacles(self, robot_index: int, pose: Pose) -> Excess | None:
        """Check whether a robot is in an obstacle, or will be after its reaction time.

        The prediction uses the rates of the last transmission. A robot that was in an obstacle when
        the run started may leave it. Then the limit is the smallest depth that the robot has
        reached since.

        Returns:
            The depth, now or after the reaction, and its limit. None if it is within the limit.
        """
        error_max = self._largest_error
        depth = self._compute_depth(pose.x, pose.y)
        depth_min = self._minimum_depths[robot_index] = min(
            depth, self._minimum_depths.get(robot_index, depth)
        )
        depth_max = 0.0
        if depth_min > -error_max:
            depth_max = max(depth_min, 0.0) + error_max
        elif depth <= depth_max:
            depth = self._predict_depth(robot_index, pose)
        if depth <= depth_max:
            return None
        return Excess(
            "obstacle",
            depth * self._rules.mm_per_unit,
            depth_max * self._rules.mm_per_unit,
            "mm",
            robot_index,
        )

    def _predict_depth(self, robot: int, pose: Pose) -> float:
        """Predict how deep a robot will be in an obstacle after its reaction time.

        The depth is in the spec's length unit, and negative outside.
        """
        reaction_s = self._rules.limits.reaction
        turn_rad = self._turning[robot] * reaction_s
        dx, dy = arc_displacement(pose.heading, turn_rad, self._speeds[robot] * reaction_s)
        return self._compute_depth(pose.x + dx, pose.y + dy)

    def _compute_depth(self, x: float, y: float) -> float:
        """Compute how deep the centre of a robot is in an obstacle [length unit].

        The depth is negative outside, and -inf if no obstacle is near.
        """
        deepest = -math.inf
        error_max = self._largest_error
        for shape in self._rules.obstacles:
            left, bottom, right, top = shape.box
            if (
                left - error_max <= x <= right + error_max
                and bottom - error_max <= y <= top + error_max
            ):
                distance = shape.distance(np.array(x), np.array(y))
                deepest = max(deepest, -float(distance))
        return deepest


def distance_outside(arena: Bounds, pose: Pose) -> float:
    """Compute the distance of a position from the arena [length unit]. It is 0 inside."""
    return math.hypot(
        max(arena.left - pose.x, 0.0, pose.x - arena.right),
        max(arena.bottom - pose.y, 0.0, pose.y - arena.top),
    )


def compute_edge_excess(rules: GuardRules, robot: int, predicted: Pose) -> Excess:
    """Describe how far outside the arena a robot will be after its reaction time.

    Args:
        rules: The limits.
        robot: Index of the robot.
        predicted: Its pose after its reaction time.
    """
    return Excess(
        "arena", distance_outside(rules.arena, predicted) * rules.mm_per_unit, 0.0, "mm", robot
    )


def drive_ahead(pose: Pose, distance: float) -> Pose:
    """Return the pose after a robot has driven a distance along its heading."""
    dx = distance * math.cos(pose.heading)
    dy = distance * math.sin(pose.heading)
    return Pose(pose.x + dx, pose.y + dy, pose.heading)


def find_too_close(
    poses: Mapping[str, Pose], predicted: Mapping[str, Pose], rules: GuardRules
) -> Iterator[Finding]:
    """Find pairs of robots that come closer than the minimum distance.

    Args:
        poses: Present poses, by robot.
        predicted: Predicted poses at the earliest time when the robots could be stopped, by robot.
        rules: The limits.

    Yields:
        An abort for each pair.
    """
    separation_mm = rules.limits.separation_mm
    names = list(poses)
    for i, name in enumerate(names):
        for neighbour in names[:i]:
            gap = poses[name].distance_to(poses[neighbour])
            predicted_gap = predicted[name].distance_to(predicted[neighbour])
            if predicted_gap <= gap and predicted_gap * rules.mm_per_unit < separation_mm:
                robot_index = rules.names.index(name)
                excess = Excess(
                    "separation",
                    predicted_gap * rules.mm_per_unit,
                    separation_mm,
                    "mm",
                    robot_index,
                )
                text = f"{neighbour} and {name} are too close: {gap * rules.mm_per_unit:.0f} mm"
                yield Abort(text, excess=excess)
