"""The warnings about a valid spec: problems that may prevent a trial from working as intended.

`RULES` lists all warnings. Each rule reads the numbers of a spec, which are gathered in a
`CheckContext`, and yields its findings (where, text, hint). The first line of its docstring says
what it finds. docs/reference/warnings.md explains the warnings. The rules that make a spec invalid
are in `tetractl.spec.consistency`.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel

from tetractl.control.search.near_targets import target_separation
from tetractl.core.elementary import expm1
from tetractl.core.poses import Floats, describe_excess_angle, wrap
from tetractl.core.setup import Setup
from tetractl.model import bounds
from tetractl.model.bounds import compute_min_distances
from tetractl.model.free_space import blocked_target_distances, compute_clearances
from tetractl.spec.base import ANGLE_MARK
from tetractl.spec.consistency import Findings, SpecFinding, find_nearest
from tetractl.spec.experiment import Experiment
from tetractl.spec.lab_section import LabSection
from tetractl.spec.loaded_spec import LoadedSpec
from tetractl.spec.section_abilities import (
    Accepting,
    CountsSteps,
    Delaying,
    Estimating,
    HoldsSignals,
    KeepsClear,
    Modelled,
    PlansSignals,
)
from tetractl.spec.yaml.document import Document
from tetractl.spec.yaml.problems import Loc, SpecProblem, format_loc

TURN_PER_SIGNAL_MAX = 2.0
"""Maximum product of turning rate a and duration T of a signal, above which a warning is given.

Above it, headings computed with the paper's equation (6) oscillate with a growing amplitude.
"""
A_MAX = 60.0
"""Maximum plausible turning rate of a robot [rad/s]. Above it, a warning is given.

The fastest published here, a microjet, has 25 rad/s.
"""
WHEEL_RADIUS_RANGE_M = (0.005, 0.3)
"""Minimum and maximum plausible distance of a wheel from the centre [m].

toio cubes have 0.013, m3pi robots 0.04, the iRobot Create 0.13, and the largest laboratory robots
0.27.
"""
OVERSHOOTING_MOTION = "euler"
"""The kind of motion that computes the heading with the paper's equation (6)."""
SIMILARITY_TOLERANCE = 0.05
"""Maximum difference between similar robots.

Their turning rates a differ by at most this fraction, and their start headings by at most this
number of radians.
"""
SAME_HEADING_RAD = 1e-9
"""Difference below which two start headings count as equal [rad]; it only allows for rounding."""
NOISE_FACTOR = 0.7
"""Minimum reasonable `accept_error`, in standard deviations of a measured position for each robot.

With 0.4 instead of 0.7, trials last longer, and their error hardly decreases
(docs/decisions/controller.md).
"""
TIME_TOLERANCE = 1e-9
"""Relative difference below which two times count as equal; it only allows for rounding."""
ERROR_TOLERANCE = 1e-6
"""Fraction of the arena's longer side below which a lower bound of the total error counts as 0."""
OTHERS_NAMED_MAX = 2
"""If more than four robots are similar, the message names the first and this many more."""


class CheckContext:
    """An experiment, and the numbers of its controller that the rules read."""

    def __init__(self, experiment: Experiment) -> None:
        control = experiment.controller
        self.experiment = experiment
        self.setup = experiment.setup
        self.unit = self.setup.unit
        self.points_by_field = {"start": self.setup.starts.xy, "target": self.setup.targets}
        """The points (N, 2) at which robots start and end, under the keys "start" and "target"."""
        self.tolerance = control.arrival_tolerance
        """Distance from its target at which a robot has arrived [length unit]."""
        periods = control.signal_periods if isinstance(control, HoldsSignals) else 1
        self.signal_s = control.period * periods
        """Time for which a signal of a plan is held [s]."""
        signals_max = control.horizon_max if isinstance(control, PlansSignals) else math.inf
        self.plan_max_s = signals_max * self.signal_s
        """Maximum duration of a plan [s]. inf if it is not limited."""
        self.trial_max_s = self.setup.time_limit_s
        """Maximum time for which robots move in a trial [s]."""
        self.collision = control.collision if isinstance(control, KeepsClear) else None
        """The distances that plans keep. None if they keep none."""
        self.margin = 0.0
        """Distance that plans keep to obstacles, including a robot's radius [length unit]."""
        self.avoids_walls = False
        """Whether plans also keep this distance to the arena's edge."""
        if self.collision is not None:
            self.margin = self.collision.margin + self.collision.radius
            self.avoids_walls = self.collision.walls

    @property
    def time_limit_field(self) -> str:
        """The controller's field that limits the trial's time: "steps_max" or "time_limit"."""
        control = self.experiment.controller
        steps_max = control.steps_max if isinstance(control, CountsSteps) else math.inf
        steps_s = (steps_max + 1) * control.period
        return "steps_max" if steps_s <= self.trial_max_s * (1 + TIME_TOLERANCE) else "time_limit"

    def is_worth_warning(self, error_min: float, n_robots: int) -> bool:
        """Decide whether a lower bound of the total error of some robots deserves a warning.

        It does if it is above the arrival tolerance of all `robots` robots together, and above
        rounding errors.
        """
        arena = self.setup.arena
        return error_min > max(
            n_robots * self.tolerance, ERROR_TOLERANCE * max(arena.width, arena.height)
        )

    def clearances(self, points: Floats) -> Floats:
        """Return the distances of points (N, 2) to the nearest obstacle or wall."""
        return compute_clearances(self.setup, points[:, 0], points[:, 1], self.avoids_walls)

    def length_text(self, length: float) -> str:
        """Return a length as text, with the unit of the spec, such as "12.5 mm"."""
        return f"{length:.4g} {self.unit}"

    def target_distance_text(self, i: int) -> str:
        """Return the distance from robot i's start to its target as text with its unit."""
        return self.length_text(float(self.setup.starts.distances(self.setup.targets)[i]))

    def driven_distance_text(self, i: int, seconds: float) -> str:
        """Return the distance that robot i drives in a time [s], as text with its unit."""
        return self.length_text(self.setup.speed[i] * seconds)


def angles_of_many_turns(context: CheckContext) -> Findings:
    """Angles of more than a whole turn, which are probably degrees."""
    for location, value in _angles_in_section(context.experiment, ()):
        problem = describe_excess_angle(value)
        if problem is not None:
            problem_text, hint = problem
            yield SpecFinding(location, problem_text, hint)


def turns_faster_than_robots(context: CheckContext) -> Findings:
    """Turning rates above A_MAX, which are probably in degrees a second."""
    for i, rate in enumerate(context.setup.a.tolist()):
        if rate > A_MAX:
            text = (
                f"is {rate:g} rad/s, which is implausibly fast: the robot would turn to any "
                f"direction within {3 / rate:.2g} s"
            )
            hint = f"if this is in degrees per second, write {math.radians(rate):.4g}"
            yield SpecFinding(("robots", i, "a"), text, hint)


def robots_of_another_size(context: CheckContext) -> Findings:
    """Wheels so far from the centre, or so near, that the unit of length is probably wrong."""
    setup = context.setup
    if setup.wheel_radius is None:
        return
    radius_m = setup.wheel_radius * setup.metres
    if not WHEEL_RADIUS_RANGE_M[0] <= radius_m <= WHEEL_RADIUS_RANGE_M[1]:
        text = f"means that the wheels of each robot are {2 * radius_m:.3g} m apart"
        hint = f"check the value, and the length unit of the spec (units.length: {setup.unit})"
        yield SpecFinding(("wheels", "radius"), text, hint)


def _angles_in_section(section: BaseModel, location: Loc) -> Iterator[tuple[Loc, float]]:
    """Yield location and value of each number in the fields of a section that are angles."""
    fields = type(section).model_fields
    for name, value in section:
        located_values = [((*location, name), value)]
        if isinstance(value, tuple):
            located_values = [((*location, name, index), item) for index, item in enumerate(value)]
        for item_location, located_value in located_values:
            if isinstance(located_value, BaseModel):
                yield from _angles_in_section(located_value, item_location)
            elif isinstance(located_value, float) and ANGLE_MARK in fields[name].metadata:
                yield item_location, located_value


def plan_outlasts_trial(context: CheckContext) -> Findings:
    """Plans that take longer than the trial."""
    if not context.trial_max_s * (1 + TIME_TOLERANCE) < context.plan_max_s < math.inf:
        return
    fitting = max(int(context.trial_max_s / context.signal_s * (1 + TIME_TOLERANCE)), 1)
    yield SpecFinding(
        ("controller", "horizon_max"),
        f"plans of {context.plan_max_s:.4g} s are longer than the trial, which ends after "
        f"{context.trial_max_s:.4g} s",
        f"raise controller.{context.time_limit_field}, or lower horizon_max to {fitting}",
    )


def signals_held_too_long(context: CheckContext) -> Findings:
    """Signals held so long that robots finish turning, or overshoot.

    An exact motion holds for any period, and one fast robot still differs from the others.
    """
    turns_per_signal = context.setup.a * context.signal_s  # a T of each robot
    excessive_turns = turns_per_signal[turns_per_signal > TURN_PER_SIGNAL_MAX]
    control = context.experiment.controller
    overshoots = isinstance(control, Modelled) and control.motion == OVERSHOOTING_MOTION
    if not excessive_turns.size or (excessive_turns.size == 1 and not overshoots):
        return
    if overshoots:
        reason = (
            "by equation (6) of the paper, its heading then overshoots the direction further at "
            "each step"
        )
    else:
        # a small angle to the direction falls by exp(-a T): the slowest of them turns least
        percent = 100 * -expm1(-float(excessive_turns.min()))
        reason = (
            f"{excessive_turns.size} robots complete {percent:.3g} % or more of every turn within "
            "one signal"
        )
    quickest = int(turns_per_signal.argmax())
    yield SpecFinding(
        ("controller", "period"),
        f"each signal lasts T = {context.signal_s:.4g} s, which is too long for "
        f"{context.setup.names[quickest]}: its turning rate a times T is "
        f"{turns_per_signal[quickest]:.3g}, above {TURN_PER_SIGNAL_MAX:g}: {reason}",
        f"hold signals for less than {TURN_PER_SIGNAL_MAX / context.setup.a[quickest]:.3g} s",
    )


def wrong_dead_time(context: CheckContext) -> Findings:
    """A plant's dead time that differs from the controller's by more than a control period.

    There is no warning if the controller identifies the dead time.
    """
    plant = context.experiment.plant
    control = context.experiment.controller
    is_identified = isinstance(control, Estimating) and control.estimate
    if not isinstance(plant, Delaying) or is_identified:
        return
    assumed_s = control.dead_time
    late_periods = (plant.dead_time - assumed_s) / context.setup.period_s
    if abs(late_periods) <= 1:
        return
    lateness = "late" if late_periods > 0 else "early"
    yield SpecFinding(
        ("plant", "dead_time"),
        f"is {plant.dead_time:.4g} s, but the controller assumes {assumed_s:.4g} s, so that "
        f"every command acts {abs(late_periods):.2g} control periods too {lateness}",
        f"set controller.dead_time to {plant.dead_time:.4g}",
    )


def inseparable_robots(context: CheckContext) -> Findings:
    """Robots that one signal cannot separate, although their targets require it."""
    for group in _groups_of_similar(context.setup):
        similar = context.setup.select_robots(group)
        identical_robots = replace(
            similar,
            a=np.full_like(similar.a, similar.a[0]),
            starts=replace(
                similar.starts, heading=np.full_like(similar.a, similar.starts.heading[0])
            ),
        )
        error_min = bounds.compute_min_total_error(identical_robots, context.trial_max_s)
        if context.is_worth_warning(error_min, len(group)):
            yield SpecFinding(
                ("robots", group[1], "a"),
                _describe_similar(similar, context.length_text(error_min)),
                "give the robots different turning rates a, or targets with the same relative "
                "positions as their starts",
            )


def _groups_of_similar(setup: Setup) -> Iterator[list[int]]:
    """Yield groups of robots with similar turning rates and start headings, as indices.

    Each group has at least two robots, which are similar to its first robot.
    """
    heading = setup.starts.heading
    ungrouped = np.ones(len(setup.a), dtype=np.bool_)
    for i in range(len(setup.a)):
        if ungrouped[i]:
            same_a = np.abs(setup.a - setup.a[i]) <= SIMILARITY_TOLERANCE * np.maximum(
                setup.a, setup.a[i]
            )
            same_heading = np.abs(wrap(heading - heading[i])) <= SIMILARITY_TOLERANCE
            group = ungrouped & same_a & same_heading
            ungrouped &= ~group
            if group.sum() > 1:
                yield np.flatnonzero(group).tolist()


def _describe_similar(similar: Setup, error_min: str) -> str:
    """Describe how similar some robots are.

    Args:
        similar: The setup of only the similar robots.
        error_min: The lower bound of their total error, as text with its unit.
    """
    first_name, *other_names = similar.names
    others_text = _join_names(other_names)
    n_robots = len(similar.names)
    rate_spread = float(np.ptp(similar.a) / similar.a.mean())
    headings = similar.starts.heading
    heading_differences = np.abs(wrap(headings - headings[0]))
    heading_spread = float(heading_differences.max())
    if rate_spread == 0 and heading_spread < SAME_HEADING_RAD:
        turn_verb = "turns" if len(other_names) == 1 else "turn"
        start_verb = "starts" if len(other_names) == 1 else "start"
        return (
            f"{others_text} {turn_verb} at the same rate as {first_name} and {start_verb} with the "
            f"same heading, so the {n_robots} can only move in parallel: their total error cannot "
            f"fall below {error_min}"
        )
    return (
        f"{others_text} and {first_name} differ by only {100 * rate_spread:.2g} % in turning rate "
        f"a and {heading_spread:.2g} rad in start heading. That may be too little to separate "
        f"them: the total error of {n_robots} identical robots could not fall below {error_min}"
    )


def _join_names(names: Sequence[str]) -> str:
    """Join names as "a, b and c". Names after the first few are counted, such as "2 more"."""
    shown_names = list(names)
    if len(names) > OTHERS_NAMED_MAX + 1:
        shown_names = [*names[:OTHERS_NAMED_MAX], f"{len(names) - OTHERS_NAMED_MAX} more"]
    if len(shown_names) == 1:
        return shown_names[0]
    return f"{', '.join(shown_names[:-1])} and {shown_names[-1]}"


def targets_out_of_reach(context: CheckContext) -> Findings:
    """Targets that a robot cannot reach in a trial, even along a straight line."""
    for i, shortfall in enumerate(compute_min_distances(context.setup, context.trial_max_s)):
        if shortfall > context.tolerance:
            yield SpecFinding(
                ("robots", i, "target"),
                f"is {context.target_distance_text(i)} away, but the robot drives only "
                f"{context.driven_distance_text(i, context.trial_max_s)} in the "
                f"{context.trial_max_s:.4g} s of a trial, {shortfall:.4g} too little",
                f"raise controller.{context.time_limit_field}, or bring the target nearer",
            )


def targets_beyond_plan(context: CheckContext) -> Findings:
    """The furthest target that a robot can reach in a trial, but not in the longest plan."""
    if context.plan_max_s == math.inf:
        return
    shortfalls = compute_min_distances(context.setup, context.plan_max_s)
    out_of_plan = (shortfalls > context.tolerance) & (
        compute_min_distances(context.setup, context.trial_max_s) <= context.tolerance
    )
    if not out_of_plan.any():
        return
    needed_s = {
        i: float(shortfalls[i] / context.setup.speed[i]) + context.plan_max_s
        for i in np.flatnonzero(out_of_plan).tolist()
    }
    i = max(needed_s, key=needed_s.__getitem__)  # the robot that needs most time
    yield SpecFinding(
        ("controller", "horizon_max"),
        f"{context.setup.names[i]} is {context.target_distance_text(i)} from its target, but "
        f"drives only {context.driven_distance_text(i, context.plan_max_s)} in "
        f"{round(context.plan_max_s / context.signal_s)} signals ({context.plan_max_s:.4g} s),"
        f" {shortfalls[i]:.4g} too little",
        f"set it to more than {math.ceil(needed_s[i] / context.signal_s)}",
    )


def unavoidable_error(context: CheckContext) -> Findings:
    """A lower bound of the total error that is above 0, so that no plan reaches all targets."""
    error_min = bounds.compute_min_total_error(context.setup, context.trial_max_s)
    if context.is_worth_warning(error_min, len(context.setup.a)):
        yield SpecFinding(
            ("robots",),
            f"the smallest total error of any plan is {error_min:.4g} {context.unit}",
            "no controller can achieve a smaller error with these a, speeds, starts and targets",
        )


def walled_off_targets(context: CheckContext) -> Findings:
    """Targets to which no path leads past the obstacles, or no path with the margin."""
    if not context.experiment.obstacles:
        return
    setup = context.setup
    blocked_distances = blocked_target_distances(setup, 0.0, context.avoids_walls)
    blocked_distances_with_margin = (
        blocked_target_distances(setup, context.margin, context.avoids_walls)
        if context.margin > 0
        else blocked_distances
    )
    end_clearances = np.minimum(
        context.clearances(setup.starts.xy), context.clearances(setup.targets)
    )
    for i in np.flatnonzero((blocked_distances > 0) | (blocked_distances_with_margin > 0)).tolist():
        if blocked_distances[i] > 0:
            yield SpecFinding(
                ("robots", i, "target"),
                f"is walled off: the robot cannot come closer than {blocked_distances[i]:.4g} "
                f"{context.unit}",
                "open a gap between the obstacles",
            )
        elif end_clearances[i] > context.margin:
            yield SpecFinding(
                ("robots", i, "target"),
                "cannot be reached by a path that keeps "
                f"{context.length_text(context.margin)} from the obstacles; the robot comes "
                f"within {context.length_text(blocked_distances_with_margin[i])}",
                "lower controller.collision.margin or radius, or widen the gap",
            )


def points_inside_margin(context: CheckContext) -> Findings:
    """Starts and targets that are nearer to an obstacle than the planner's fixed margin."""
    if not context.margin or not context.collision or context.collision.adaptive:
        return
    for field, points in context.points_by_field.items():
        gaps = context.clearances(points)
        for i in np.flatnonzero(gaps <= context.margin).tolist():
            yield SpecFinding(
                ("robots", i, field),
                f"is {gaps[i]:.4g} {context.unit} from the nearest obstacle or wall, but the "
                f"controller's plans keep a distance of {context.margin:.4g} {context.unit}",
                "move it, or lower controller.collision.margin or radius",
            )


def targets_near_obstacles(context: CheckContext) -> Findings:
    """Targets so near to an obstacle that an adaptive margin gives way there.

    That happens within the distance that a robot drives in a control period.
    """
    if not context.collision or not context.collision.radius or not context.collision.adaptive:
        return
    free_space = context.clearances(context.setup.targets) - context.collision.radius
    step_distances = context.setup.speed * context.experiment.controller.period
    for i in np.flatnonzero(free_space < context.collision.margin + step_distances).tolist():
        yield SpecFinding(
            ("robots", i, "target"),
            f"leaves only {free_space[i]:.3g} {context.unit} of free space between the robot's "
            "body and the nearest obstacle or edge, but the robot drives "
            f"{step_distances[i]:.3g} {context.unit} in a control period",
            "move the target, or shorten the control period; otherwise a trial may end far "
            "from the target",
        )


def accepts_less_than_noise(context: CheckContext) -> Findings:
    """An accepted error that is less than the camera's noise."""
    control = context.experiment.controller
    if not isinstance(control, Accepting):
        return
    error_min = NOISE_FACTOR * control.prior.position_noise * len(context.setup.names)
    if control.accept_error < error_min:
        yield SpecFinding(
            ("controller", "accept_error"),
            f"is less than {NOISE_FACTOR} x position_noise x number of robots, {error_min:.3g} "
            f"{context.unit}: the camera can hardly measure such a small error, so that "
            "trials take longer and gain little",
            f"set it to {error_min:.3g} {context.unit} or more",
        )


def points_below_separation(context: CheckContext) -> Findings:
    """Starts or targets that are closer to each other than the lab's minimum separation."""
    per_mm = 1e-3 / context.setup.metres
    sections = {"plant": context.experiment.plant, "lab": context.experiment.lab}
    for section, plant in sections.items():
        if not isinstance(plant, LabSection):
            continue
        separation_min_mm = plant.limits.separation_mm
        for field, points in context.points_by_field.items():
            for i, neighbour, distance in find_nearest(context.setup, points):
                if distance < separation_min_mm * per_mm:
                    yield SpecFinding(
                        ("robots", i, field),
                        f"is {distance / per_mm:.4g} mm from the {field} of {neighbour}, but "
                        f"the lab aborts if robots are closer than {separation_min_mm:.4g} mm",
                        f"move them apart, or lower {section}.limits.separation_mm",
                    )


def coinciding_points(context: CheckContext) -> Findings:
    """The first two equal starts, and the first two equal targets."""
    for field, points in context.points_by_field.items():
        for i, neighbour, distance in find_nearest(context.setup, points):
            if distance == 0:
                gap = context.length_text(0.0)
                text = (
                    f"is {gap} from the {field} of {neighbour}, so that the two robots "
                    "cannot both stand there"
                )
                yield SpecFinding(("robots", i, field), text, "move one of them")
                break


def targets_near_each_other(context: CheckContext) -> Findings:
    """Targets so close together that the bodies of robots could touch there.

    The controller then steers the robots to points further apart.
    """
    if not context.collision:
        return
    setup = context.setup
    separation_min = target_separation(context.collision, setup.speed, setup.period_s)
    for i, neighbour, distance in find_nearest(setup, setup.targets):
        if 0 < distance < separation_min:
            gap = context.length_text(distance)
            yield SpecFinding(
                ("robots", i, "target"),
                f"is {gap} from the target of {neighbour}, so that the two robots might "
                f"touch: the controller keeps them {separation_min:.4g} {context.unit} apart",
                "move the targets apart; otherwise a trial ends with a total error of about "
                f"{separation_min - distance:.2g} {context.unit} or more",
            )


def hold_radius_too_small(context: CheckContext) -> Findings:
    """A hold within less than v / a of robots that cannot stand still."""
    setup = context.setup
    if setup.hold is None or setup.on_wheels:
        return
    for name, radius_min in zip(setup.names, (setup.speed / setup.a).tolist(), strict=True):
        if setup.hold.radius < radius_min:
            text = (
                f"is too small: {name} cannot stay closer to its target than its speed divided by "
                f"its turning rate a, {radius_min:.4g} {context.unit} on average"
            )
            yield SpecFinding(
                ("hold", "radius"), text, "give a larger value, or use a stronger field"
            )


RULES: tuple[Callable[[CheckContext], Findings], ...] = (
    angles_of_many_turns,
    turns_faster_than_robots,
    robots_of_another_size,
    plan_outlasts_trial,
    signals_held_too_long,
    wrong_dead_time,
    inseparable_robots,
    targets_out_of_reach,
    targets_beyond_plan,
    unavoidable_error,
    walled_off_targets,
    points_inside_margin,
    targets_near_obstacles,
    accepts_less_than_noise,
    points_below_separation,
    coinciding_points,
    targets_near_each_other,
    hold_radius_too_small,
)
"""All rules, in the order in which warnings about the same line are printed."""


@dataclass(frozen=True, slots=True)
class PlacedWarning(SpecProblem):
    """A warning about a spec, with the file and line of the value that it concerns, and a hint."""

    hint: str = ""

    def __str__(self) -> str:
        return f"{SpecProblem.__str__(self)}; {self.hint}"


@np.errstate(all="ignore")  # very large values may overflow
@np.errstate(all="ignore")  # numbers at the end of floating point are compared as inf
def find_warnings(loaded: LoadedSpec) -> tuple[PlacedWarning, ...]:
    """Find the warnings about a valid spec, in the order of its lines.

    There are no warnings if the robots are placeholders, because each trial finds its own robots.
    """
    if loaded.experiment.must_choose_robots:  # its robots are placeholders
        return ()
    context = CheckContext(loaded.experiment)
    document = loaded.document or Document(loaded.name)
    warnings: list[PlacedWarning] = []
    for rule in RULES:
        for finding in rule(context):
            place = document.place(finding.loc)
            warning = PlacedWarning(
                origin=place.origin,
                message=finding.text,
                line=place.line,
                column=place.column,
                field=format_loc(finding.loc),
                value=place.text,
                hint=finding.hint,
            )
            warnings.append(warning)
    return tuple(sorted(warnings, key=lambda w: (w.line is None, w.line or 0, w.column or 0)))
