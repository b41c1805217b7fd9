"""The warnings of a valid spec: problems that may prevent a trial from working as intended.

`RULES` is the list of all warnings. Each rule reads the numbers of a spec, gathered in a
`CheckContext`, and yields its findings (where, text, hint); the first line of its docstring says
when. docs/reference/warnings.md explains the warnings; `tetractl.experiment.consistency` has the
rules by which a spec is refused.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from pydantic import BaseModel

from tetractl.core.poses import Floats, turn_problem, wrap
from tetractl.core.setup import Setup
from tetractl.experiment.consistency import nearest_starts, nearest_targets
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab_section import LabSection
from tetractl.experiment.load import LoadedSpec, SpecSetting, SpecText
from tetractl.experiment.section_abilities import (
    Accepting,
    CountsSteps,
    Delaying,
    Estimating,
    HoldsSignals,
    KeepsClear,
    Modelled,
    PlansSignals,
)
from tetractl.experiment.spec_finding import SpecFinding, warning
from tetractl.experiment.yaml.problems import Loc, SpecProblem
from tetractl.model import bounds
from tetractl.model.bounds import reach
from tetractl.model.free_space import clearance, shut_out

COARSE = 2.0
"""Largest product of turning rate a and time per signal T: above it, headings computed by the
paper's equation (6) oscillate with a growing amplitude.
"""
OVERSHOOTING = ("euler", "arc")
"""The motions whose heading advances by the paper's equation (6)."""
ROBOTS_ALIKE = 0.05
"""Robots are alike if their turning rates a differ by at most this fraction, and their start
headings by at most this number of radians."""
SAME_HEADING_RAD = 1e-9
"""Start headings that differ by less are equal but for rounding [rad]."""
SEEN = 0.7
"""Least total error worth asking for, in deviations of a measured position for each robot. With 0.4
in place of 0.7 trials last longer for hardly less error (docs/decisions/controller.md)."""
ROUNDING = 1e-9
"""Times that differ by less than this fraction are equal but for rounding."""
NO_ERROR = 1e-6
"""A least total error below this fraction of the arena's longer side is none but for rounding."""
NAMED = 2
"""Of more than four robots alike, so many are named besides the first."""

Findings = Iterator[SpecFinding]


class CheckContext:
    """An experiment, and the numbers of its controller that the rules read."""

    def __init__(self, experiment: Experiment) -> None:
        control = experiment.controller
        self.experiment = experiment
        self.setup = experiment.setup
        self.unit = experiment.setup.unit
        self.tolerance = control.arrival_tolerance
        periods = control.signal_periods if isinstance(control, HoldsSignals) else 1
        self.signal_s = control.period * periods
        """Time for which a signal of a plan is held [s]."""
        signals_max = control.horizon_max if isinstance(control, PlansSignals) else math.inf
        self.plan_s = signals_max * self.signal_s
        """Longest time of a plan [s], inf if it is not limited."""
        self.motion = control.motion if isinstance(control, Modelled) else ""
        """The controller's model of the motion, "" if it has none."""
        self.estimates = control.estimate if isinstance(control, Estimating) else False
        """Whether the controller identifies the plant's dead time."""
        self.collision = control.collision if isinstance(control, KeepsClear) else None
        """What plans keep clear of, None if they keep clear of nothing."""
        self.margin = self.collision.margin + self.collision.radius if self.collision else 0.0
        """Distance that plans keep to obstacles, including a robot's radius [length unit]."""
        self.walls = self.collision is not None and self.collision.walls
        """Whether plans keep that distance to the arena's edge too."""
        self.longest_s = self.setup.time_limit_s
        """Longest time for which robots move [s]."""
        steps_max = control.steps_max if isinstance(control, CountsSteps) else math.inf
        steps_s = (steps_max + 1) * control.period
        self.limit = "time_limit"
        """The field of the controller that sets that time."""
        if steps_s <= self.longest_s * (1 + ROUNDING):
            self.limit = "steps_max"

    @property
    def least_total_error(self) -> float:
        """A lower bound of the total error of any plan [length unit], see `model.bounds`."""
        return bounds.least_total_error(self.setup, self.longest_s)

    def counts(self, least: float, robots: int) -> bool:
        """Return whether a least total error of some robots is above the tolerance and rounding."""
        arena = self.setup.arena
        return least > max(robots * self.tolerance, NO_ERROR * max(arena.width, arena.height))

    def clearances(self, points: Floats) -> Floats:
        """Return the distances of points (N, 2) to the nearest obstacle or wall."""
        return clearance(self.setup, points[:, 0], points[:, 1], self.walls)

    def too_few(self, i: int, seconds: float, left: float) -> str:
        """Return how far robot i drives in a time [s], and the distance left, as text."""
        return f"drives {self.setup.speed[i] * seconds:.4g} {self.unit}, {left:.4g} too few"

    def way(self, i: int) -> str:
        """Return the distance from a robot's start to its target as text."""
        gap = float(np.linalg.norm(self.setup.targets[i] - self.setup.starts.xy[i]))
        return f"{gap:.4g} {self.unit}"


def angles(spec: CheckContext) -> Findings:
    """Angles of more than a whole turn, which are probably degrees."""
    for where, value in _radians(spec.experiment, ()):
        problem = turn_problem(value)
        if problem is not None:
            text, hint = problem
            yield warning(where, text, hint)


def _radians(part: BaseModel, where: Loc) -> Iterator[tuple[Loc, float]]:
    """Yield location and value of each number in those fields of a section described in [rad]."""
    fields = type(part).model_fields
    for name, value in part:
        items = [((*where, name), value)]
        if isinstance(value, tuple):
            items = [((*where, name, index), item) for index, item in enumerate(value)]
        for place, item in items:
            if isinstance(item, BaseModel):
                yield from _radians(item, place)
            elif isinstance(item, float) and "[rad]" in (fields[name].description or ""):
                yield place, item


def plan_outlasts_trial(spec: CheckContext) -> Findings:
    """Plans that take longer than a trial."""
    if not spec.longest_s * (1 + ROUNDING) < spec.plan_s < math.inf:
        return
    fitting = max(int(spec.longest_s / spec.signal_s * (1 + ROUNDING)), 1)
    yield warning(
        ("controller", "horizon_max"),
        f"plans of {spec.plan_s:.4g} s outlast the trial, which ends after {spec.longest_s:.4g} s",
        f"raise controller.{spec.limit}, or lower horizon_max to {fitting}",
    )


def coarse_period(spec: CheckContext) -> Findings:
    """Signals held so long that robots finish turning, or overshoot.

    An exact motion holds for any period, and one fast robot still differs from the others.
    """
    turned = spec.setup.a * spec.signal_s
    quick = turned[turned > COARSE]
    overshoots = spec.motion in OVERSHOOTING
    if not quick.size or (quick.size == 1 and not overshoots):
        return
    quickest = int(turned.argmax())
    share = -100 * math.expm1(-float(quick.min()))
    reason = f"{quick.size} robots make {share:.3g} % or more of a turn in T"
    if overshoots:
        reason = "by equation (6) its heading overshoots a held direction further at each step"
    yield warning(
        ("controller", "period"),
        f"a T = {turned[quickest]:.3g} for {spec.setup.names[quickest]}, with signals held for T = "
        f"{spec.signal_s:.4g} s, is above 2: {reason}",
        f"hold signals for less than {COARSE / spec.setup.a[quickest]:.3g} s",
    )


def unknown_dead_time(spec: CheckContext) -> Findings:
    """A plant whose dead time differs from the controller's by more than a control period, unless
    the controller identifies it.
    """
    plant = spec.experiment.plant
    if not isinstance(plant, Delaying) or spec.estimates:
        return
    assumed_s = spec.experiment.controller.dead_time
    late_periods = (plant.dead_time - assumed_s) / spec.setup.period_s
    if abs(late_periods) <= 1:
        return
    side = "late" if late_periods > 0 else "early"
    yield warning(
        ("plant", "dead_time"),
        f"is {plant.dead_time:.4g} s, but the controller assumes {assumed_s:.4g} s: every command "
        f"acts {abs(late_periods):.2g} control periods too {side}",
        f"set controller.dead_time to {plant.dead_time:.4g}",
    )


def robots_alike(spec: CheckContext) -> Findings:
    """Robots that one signal cannot separate, though their targets require it."""
    for group in _groups_alike(spec.setup):
        alike = spec.setup.only(group)
        least = bounds.least_total_error(alike, spec.longest_s, alike=True)
        if spec.counts(least, len(group)):
            yield warning(
                ("robots", group[1], "a"),
                f"{_words_alike(alike)} {least:.4g} {spec.unit}",
                "give them different a, or targets with the same relative positions as the starts",
            )


def _groups_alike(setup: Setup) -> Iterator[list[int]]:
    """Yield groups of robots that are like the group's first in turning rate and start heading."""
    heading = setup.starts.heading
    ungrouped = np.ones(len(setup.a), dtype=np.bool_)
    for i in range(len(setup.a)):
        if ungrouped[i]:
            same_a = np.abs(setup.a - setup.a[i]) <= ROBOTS_ALIKE * np.maximum(setup.a, setup.a[i])
            same_heading = np.abs(wrap(heading - heading[i])) <= ROBOTS_ALIKE
            group = ungrouped & same_a & same_heading
            ungrouped &= ~group
            if group.sum() > 1:
                yield np.flatnonzero(group).tolist()


def _words_alike(alike: Setup) -> str:
    """Return what makes these robots alike, up to the number of the least total error."""
    first, *others = alike.names
    them = _listed(others)
    robots = len(alike.names)
    spread = float(np.ptp(alike.a) / alike.a.mean())
    turned = float(np.abs(wrap(alike.starts.heading - alike.starts.heading[0])).max())
    if spread == 0 and turned < SAME_HEADING_RAD:
        return (
            f"is that of {first}, and so is the start heading: {them} can only move "
            f"in parallel, and the least total error of the {robots} is"
        )
    return (
        f"{them} and {first} differ by {100 * spread:.2g} % in turning rate a and "
        f"{turned:.2g} rad in start heading, perhaps too little to separate them: if "
        f"they did not differ, the least total error of the {robots} would be"
    )


def _listed(names: Sequence[str]) -> str:
    """Return names as "a, b and c", those after the second as "2 more" if there are many."""
    shown = list(names)
    if len(names) > NAMED + 1:
        shown = [*names[:NAMED], f"{len(names) - NAMED} more"]
    if len(shown) == 1:
        return shown[0]
    return f"{', '.join(shown[:-1])} and {shown[-1]}"


def out_of_reach(spec: CheckContext) -> Findings:
    """Targets that a robot cannot reach in a trial, even along a straight line."""
    for i, left in enumerate(reach(spec.setup, spec.longest_s)):
        if left > spec.tolerance:
            yield warning(
                ("robots", i, "target"),
                f"is {spec.way(i)} away; in the {spec.longest_s:.4g} s of a trial the robot "
                f"{spec.too_few(i, spec.longest_s, left)}",
                f"raise controller.{spec.limit}, or bring the target nearer",
            )


def beyond_the_plan(spec: CheckContext) -> Findings:
    """Targets that a robot can reach in a trial, but not in the longest plan: the furthest."""
    if spec.plan_s == math.inf:
        return
    left = reach(spec.setup, spec.plan_s)
    far = (left > spec.tolerance) & (reach(spec.setup, spec.longest_s) <= spec.tolerance)
    if not far.any():
        return
    speed = np.where(far, spec.setup.speed, 1.0)  # robots that are not far may stand
    needed_s = np.where(far, left / speed + spec.plan_s, 0.0)
    i = int(needed_s.argmax())
    yield warning(
        ("controller", "horizon_max"),
        f"{spec.setup.names[i]} is {spec.way(i)} from its target; in "
        f"{round(spec.plan_s / spec.signal_s)} signals, "
        f"{spec.plan_s:.4g} s, it {spec.too_few(i, spec.plan_s, left[i])}",
        f"set it to more than {math.ceil(needed_s[i] / spec.signal_s)}",
    )


def error_left(spec: CheckContext) -> Findings:
    """No plan can reach all targets: the lower bound of the total error is not 0."""
    least = spec.least_total_error
    if spec.counts(least, len(spec.setup.a)):
        yield warning(
            ("robots",),
            f"least total error of any plan: {least:.4g} {spec.unit}",
            "no controller can do better with these a, speeds, starts and targets",
        )


def walled_off(spec: CheckContext) -> Findings:
    """Targets to which no path leads past the obstacles, or no path with the margin."""
    if not spec.experiment.obstacles:
        return
    setup = spec.setup
    apart = shut_out(setup, 0.0, spec.walls)
    squeezed = shut_out(setup, spec.margin, spec.walls) if spec.margin > 0 else apart
    ends = np.minimum(spec.clearances(setup.starts.xy), spec.clearances(setup.targets))
    for i in np.flatnonzero((apart > 0) | (squeezed > 0)).tolist():
        if apart[i] > 0:
            yield warning(
                ("robots", i, "target"),
                f"is walled off: the robot comes no nearer than {apart[i]:.4g} {spec.unit}",
                "open a gap between the obstacles",
            )
        elif ends[i] > spec.margin:
            yield warning(
                ("robots", i, "target"),
                f"has no path to it that keeps {spec.margin:.4g} {spec.unit} from the obstacles: "
                f"the robot comes within {squeezed[i]:.4g} {spec.unit}",
                "lower controller.collision.margin or radius, or widen the gap",
            )


def inside_margin(spec: CheckContext) -> Findings:
    """Starts and targets that are nearer to an obstacle than the planner's fixed margin."""
    if not spec.margin or not spec.collision or spec.collision.adaptive:
        return
    for field, points in (("start", spec.setup.starts.xy), ("target", spec.setup.targets)):
        gaps = spec.clearances(points)
        for i in np.flatnonzero(gaps <= spec.margin).tolist():
            yield warning(
                ("robots", i, field),
                f"is {gaps[i]:.4g} {spec.unit} from the nearest obstacle or wall; plans keep "
                f"{spec.margin:.4g} {spec.unit}",
                "move it, or lower controller.collision.margin or radius",
            )


def tight(spec: CheckContext) -> Findings:
    """Targets so near to an obstacle that an adaptive margin gives way to the way that a robot
    drives in a control period.
    """
    if not spec.collision or not spec.collision.radius or not spec.collision.adaptive:
        return
    room = spec.clearances(spec.setup.targets) - spec.collision.radius
    step = spec.setup.speed * spec.experiment.controller.period
    for i in np.flatnonzero(room < spec.collision.margin + step).tolist():
        yield warning(
            ("robots", i, "target"),
            f"leaves a body {room[i]:.3g} {spec.unit} of room to the nearest obstacle or edge; "
            f"it drives {step[i]:.3g} {spec.unit} in a control period",
            "move the target, or control more often; a trial may end far from it",
        )


def accepts_less_than_seen(spec: CheckContext) -> Findings:
    """An accepted error that is less than the camera's noise."""
    control = spec.experiment.controller
    if not isinstance(control, Accepting):
        return
    least = SEEN * control.prior.position_noise * len(spec.setup.names)
    if control.accept_error < least:
        yield warning(
            ("controller", "accept_error"),
            f"is less than {SEEN} x position_noise x robots, {least:.3g} {spec.unit}: so small an "
            "error is hardly seen, and trials take longer for little",
            f"accept {least:.3g} {spec.unit} or more",
        )


def too_close(spec: CheckContext) -> Findings:
    """Starts or targets nearer to each other than the lab's least separation."""
    per_mm = 1e-3 / spec.setup.metres
    for section, lab in (("plant", spec.experiment.plant), ("lab", spec.experiment.lab)):
        if not isinstance(lab, LabSection):
            continue
        least_mm = lab.limits.separation_mm
        for field, nearest in (("start", nearest_starts), ("target", nearest_targets)):
            for i, other in nearest(spec.setup):
                if other.distance < least_mm * per_mm:
                    yield warning(
                        ("robots", i, field),
                        f"is {other.distance / per_mm:.4g} mm from the {field} of {other.name}; "
                        f"the lab aborts when robots come nearer than {least_mm:.4g} mm",
                        f"move them apart, or lower {section}.limits.separation_mm",
                    )


def same_place(spec: CheckContext) -> Findings:
    """The first two equal starts, and the first two targets where robots overlap."""
    body = 2 * spec.collision.radius if spec.collision else 0.0
    for field, nearest in (("start", nearest_starts), ("target", nearest_targets)):
        for i, other in nearest(spec.setup):
            if other.distance == 0 or other.distance < body:
                place = f"is {other.distance:.4g} {spec.unit} from the {field} of {other.name}"
                text = f"{place}: both cannot stand there"
                yield warning(("robots", i, field), text, "move one of them")
                break


def hold_too_tight(spec: CheckContext) -> Findings:
    """A hold within less than v / a of robots that cannot stand still."""
    setup = spec.setup
    if setup.hold is None or setup.wheel_radius is not None:
        return
    for name, least in zip(setup.names, (setup.speed / setup.a).tolist(), strict=True):
        if setup.hold.radius < least:
            text = f"is less than v / a of {name}, {least:.4g} {spec.unit}, its least mean distance"
            yield warning(("hold", "radius"), text, "ask for more, or for a stronger field")


RULES: tuple[Callable[[CheckContext], Findings], ...] = (
    angles,
    plan_outlasts_trial,
    coarse_period,
    unknown_dead_time,
    robots_alike,
    out_of_reach,
    beyond_the_plan,
    error_left,
    walled_off,
    inside_margin,
    tight,
    accepts_less_than_seen,
    too_close,
    same_place,
    hold_too_tight,
)
"""Warnings of one line are printed in this order."""


@dataclass(frozen=True, slots=True)
class PlacedWarning(SpecProblem):
    """A warning with the file and the line of the value that it concerns."""

    hint: str = ""

    def __str__(self) -> str:
        return f"{SpecProblem.__str__(self)}; {self.hint}"


@np.errstate(all="ignore")  # very large values may overflow
def find_warnings(
    loaded: LoadedSpec, settings: Sequence[SpecSetting] = ()
) -> tuple[PlacedWarning, ...]:
    """Return the warnings of a spec that was loaded with `settings`, in the order of its lines."""
    if loaded.experiment.open:  # its robots are placeholders
        return ()
    context = CheckContext(loaded.experiment)
    findings: list[SpecFinding] = []
    for rule in RULES:
        findings += rule(context)
    if not findings:
        return ()
    origin = str(loaded.path or loaded.name)
    document = SpecText(loaded.text, origin).with_settings(settings)
    warnings: list[PlacedWarning] = []
    for finding in findings:
        place = document.place(finding.where)
        problem = place.problem(finding.where, finding.text, place.text)
        warnings.append(PlacedWarning(**asdict(problem), hint=finding.hint))
    return tuple(sorted(warnings, key=lambda w: (w.line is None, w.line or 0, w.column or 0)))
