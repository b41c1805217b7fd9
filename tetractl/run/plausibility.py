"""Warns of problems in a valid spec that may prevent a trial from working as intended. Each
function in `SPEC_CHECKS` yields field, message and hint of each problem, with its numbers.
docs/reference/warnings.md explains the warnings.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from pydantic import BaseModel

from tetractl.core.poses import Floats, turn_problem, wrap
from tetractl.core.setup import Setup
from tetractl.experiment.consistency import nearest
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab_section import LabSection
from tetractl.experiment.load import LoadedSpec, document_of
from tetractl.experiment.section_abilities import (
    CountsSteps,
    Delaying,
    Estimating,
    HoldsSignals,
    KeepsClear,
    Modelled,
    PlansSignals,
)
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

Found = Iterator[tuple[Loc, str, str]]
"""The field, the message and the hint of each warning."""


class CheckContext:
    """An experiment, and data of its controller for the checks.

    `signal_s` is the time for which a signal of a plan is held [s] and `plan_s` the longest time of
    a plan [s], inf if it is not limited; `motion` is "" if the controller has no model of the
    motion. `margin` is the distance that plans keep to obstacles, including a robot's radius.
    `longest_s` is the longest time for which robots move [s].
    """

    def __init__(self, experiment: Experiment) -> None:
        control = experiment.controller
        self.experiment, self.setup, self.unit = experiment, experiment.setup, experiment.setup.unit
        self.tolerance = control.arrival_tolerance
        periods = control.signal_periods if isinstance(control, HoldsSignals) else 1
        self.signal_s = control.period * periods
        signals_max = control.horizon_max if isinstance(control, PlansSignals) else math.inf
        self.plan_s = signals_max * self.signal_s
        self.motion = control.motion if isinstance(control, Modelled) else ""
        self.estimates = control.estimate if isinstance(control, Estimating) else False
        self.keeps = control.collision if isinstance(control, KeepsClear) else None
        self.margin = self.keeps.margin + self.keeps.radius if self.keeps else 0.0
        self.walls = self.keeps is not None and self.keeps.walls
        self.longest_s = self.setup.time_limit_s
        steps_max = control.steps_max if isinstance(control, CountsSteps) else math.inf
        ends = (steps_max + 1) * control.period <= self.longest_s * (1 + 1e-9)
        self.limit = "steps_max" if ends else "time_limit"

    @property
    def least_total_error(self) -> float:
        """A lower bound of the total error of any plan [length unit], see `model.bounds`."""
        return bounds.least_total_error(self.setup, self.longest_s)

    def counts(self, least: float, robots: int) -> bool:
        """Return whether a least total error of some robots is above the tolerance and rounding."""
        arena = self.setup.arena
        return least > max(robots * self.tolerance, 1e-6 * max(arena.width, arena.height))

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


def angles(spec: CheckContext) -> Found:
    """Warn of angles of more than a whole turn, which are probably degrees."""
    for loc, value in _radians(spec.experiment, ()):
        problem = turn_problem(value)
        if problem is not None:
            yield loc, *problem


def _radians(part: BaseModel, loc: Loc) -> Iterator[tuple[Loc, float]]:
    """Yield location and value of each number in those fields of a section described in [rad]."""
    fields = type(part).model_fields
    for name, value in part:
        for step, item in enumerate(value) if isinstance(value, tuple) else [(None, value)]:
            at = (*loc, name) if step is None else (*loc, name, step)
            if isinstance(item, BaseModel):
                yield from _radians(item, at)
            elif isinstance(item, float) and "[rad]" in (fields[name].description or ""):
                yield at, item


def plan_outlasts_trial(spec: CheckContext) -> Found:
    """Warn of plans that take longer than a trial."""
    if spec.longest_s * (1 + 1e-9) < spec.plan_s < math.inf:
        yield (
            ("controller", "horizon_max"),
            f"plans of {spec.plan_s:.4g} s outlast the trial, which ends after "
            f"{spec.longest_s:.4g} s",
            f"raise controller.{spec.limit}, or lower horizon_max to "
            f"{max(int(spec.longest_s / spec.signal_s * (1 + 1e-9)), 1)}",
        )


def coarse_period(spec: CheckContext) -> Found:
    """Warn if signals are held so long that robots finish turning, or overshoot."""
    turned = spec.setup.a * spec.signal_s
    quick, i = turned[turned > COARSE], int(turned.argmax())
    overshoots = spec.motion in OVERSHOOTING
    if not quick.size or (quick.size == 1 and not overshoots):
        return  # an exact motion holds for any period, and one fast robot differs from the others
    share = -100 * math.expm1(-float(quick.min()))
    why = f"{quick.size} robots make {share:.3g} % or more of a turn in T"
    if overshoots:
        why = "by equation (6) its heading overshoots a held direction further at each step"
    yield (
        ("controller", "period"),
        f"a T = {turned[i]:.3g} for {spec.setup.names[i]}, with signals held for T = "
        f"{spec.signal_s:.4g} s, is above 2: {why}",
        f"hold signals for less than {COARSE / spec.setup.a[i]:.3g} s",
    )


def unknown_dead_time(spec: CheckContext) -> Found:
    """Warn of a plant whose dead time differs from the controller's by more than a control period,
    unless the controller identifies it.
    """
    plant, assumed = spec.experiment.plant, spec.experiment.controller.dead_time
    if not isinstance(plant, Delaying) or spec.estimates:
        return
    true_s, late = plant.dead_time, (plant.dead_time - assumed) / spec.setup.period_s
    if abs(late) > 1:
        yield (
            ("plant", "dead_time"),
            f"is {true_s:.4g} s, but the controller assumes {assumed:.4g} s: every command "
            f"acts {abs(late):.2g} control periods too {'late' if late > 0 else 'early'}",
            f"set controller.dead_time to {true_s:.4g}",
        )


def out_of_reach(spec: CheckContext) -> Found:
    """Warn of targets that a robot cannot reach in a trial, even along a straight line."""
    for i, left in enumerate(reach(spec.setup, spec.longest_s)):
        if left > spec.tolerance:
            yield (
                ("robots", i, "target"),
                f"is {spec.way(i)} away; in the {spec.longest_s:.4g} s of a trial the robot "
                f"{spec.too_few(i, spec.longest_s, left)}",
                f"raise controller.{spec.limit}, or bring the target nearer",
            )


def beyond_the_plan(spec: CheckContext) -> Found:
    """Warn of targets that a robot can reach in a trial, but not in the longest plan."""
    if spec.plan_s == math.inf:
        return
    seconds = spec.plan_s
    left = reach(spec.setup, seconds)
    far = (left > spec.tolerance) & (reach(spec.setup, spec.longest_s) <= spec.tolerance)
    if not far.any():
        return
    needed = np.where(far, left / np.where(far, spec.setup.speed, 1.0) + seconds, 0.0)
    i = int(needed.argmax())
    yield (
        ("controller", "horizon_max"),
        f"{spec.setup.names[i]} is {spec.way(i)} from its target; in "
        f"{round(seconds / spec.signal_s)} signals, "
        f"{seconds:.4g} s, it {spec.too_few(i, seconds, left[i])}",
        f"set it to more than {math.ceil(needed[i] / spec.signal_s)}",
    )


def robots_alike(spec: CheckContext) -> Found:
    """Warn of robots that one signal cannot separate, though their targets require it."""
    for group in _alike(spec.setup):
        some = spec.setup.only(group)
        least = bounds.least_total_error(some, spec.longest_s, alike=True)
        if not spec.counts(least, len(group)):
            continue
        first, *others = some.names
        more = [f"{len(others) - 2} more"] if len(others) > 3 else []
        *front, last = [*others[:2], *more] if more else others
        them = f"{', '.join(front)} and {last}" if front else last
        spread = float(np.ptp(some.a) / some.a.mean())
        turned = float(np.abs(wrap(some.starts.heading - some.starts.heading[0])).max())
        message = (
            f"{them} and {first} differ by {100 * spread:.2g} % in turning rate a and "
            f"{turned:.2g} rad in start heading, perhaps too little to separate them: if "
            f"they did not differ, the least total error of the {len(group)} would be"
        )
        if spread == 0 and turned < 1e-9:
            message = (
                f"is that of {first}, and so is the start heading: {them} can only move "
                f"in parallel, and the least total error of the {len(group)} is"
            )
        yield (
            ("robots", group[1], "a"),
            f"{message} {least:.4g} {spec.unit}",
            "give them different a, or targets with the same relative positions as the starts",
        )


def _alike(setup: Setup) -> Iterator[list[int]]:
    """Yield groups of robots that are like the group's first in turning rate and start heading."""
    left, heading = np.ones(len(setup.a), dtype=np.bool_), setup.starts.heading
    for i in range(len(setup.a)):
        if left[i]:
            near = left & (
                np.abs(setup.a - setup.a[i]) <= ROBOTS_ALIKE * np.maximum(setup.a, setup.a[i])
            )
            near &= np.abs(wrap(heading - heading[i])) <= ROBOTS_ALIKE
            left &= ~near
            if near.sum() > 1:
                yield np.flatnonzero(near).tolist()


def error_left(spec: CheckContext) -> Found:
    """Warn if no plan can reach all targets: the lower bound of the total error is not 0."""
    least = spec.least_total_error
    if spec.counts(least, len(spec.setup.a)):
        message = f"least total error of any plan: {least:.4g} {spec.unit}"
        hint = "no controller can do better with these a, speeds, starts and targets"
        yield ("robots",), message, hint


def walled_off(spec: CheckContext) -> Found:
    """Warn of targets to which no path leads past the obstacles, or no path with the margin."""
    if not spec.experiment.obstacles:
        return
    apart = shut_out(spec.setup, 0.0, spec.walls)
    squeezed = shut_out(spec.setup, spec.margin, spec.walls) if spec.margin > 0 else apart
    ends = np.minimum(spec.clearances(spec.setup.starts.xy), spec.clearances(spec.setup.targets))
    for i in np.flatnonzero((apart > 0) | (squeezed > 0)).tolist():
        if apart[i] > 0:
            message = f"is walled off: the robot comes no nearer than {apart[i]:.4g} {spec.unit}"
            yield ("robots", i, "target"), message, "open a gap between the obstacles"
        elif ends[i] > spec.margin:
            yield (
                ("robots", i, "target"),
                f"has no path to it that keeps {spec.margin:.4g} {spec.unit} from the obstacles: "
                f"the robot comes within {squeezed[i]:.4g} {spec.unit}",
                "lower controller.collision.margin or radius, or widen the gap",
            )


def inside_margin(spec: CheckContext) -> Found:
    """Warn of starts and targets that are nearer to an obstacle than the planner's fixed margin."""
    if not spec.margin or not spec.keeps or spec.keeps.adaptive:
        return
    for field, points in (("start", spec.setup.starts.xy), ("target", spec.setup.targets)):
        gaps = spec.clearances(points)
        for i in np.flatnonzero(gaps <= spec.margin).tolist():
            yield (
                ("robots", i, field),
                f"is {gaps[i]:.4g} {spec.unit} from the nearest obstacle or wall; plans keep "
                f"{spec.margin:.4g} {spec.unit}",
                "move it, or lower controller.collision.margin or radius",
            )


def tight(spec: CheckContext) -> Found:
    """Warn of targets that are so near to an obstacle that an adaptive margin gives way to the way
    that a robot drives in a control period."""
    if not spec.keeps or not spec.keeps.radius or not spec.keeps.adaptive:
        return
    room = spec.clearances(spec.setup.targets) - spec.keeps.radius
    step = spec.setup.speed * spec.experiment.controller.period
    for i in np.flatnonzero(room < spec.keeps.margin + step).tolist():
        yield (
            ("robots", i, "target"),
            f"leaves a body {room[i]:.3g} {spec.unit} of room to the nearest obstacle or edge; "
            f"it drives {step[i]:.3g} {spec.unit} in a control period",
            "move the target, or control more often; a trial may end far from it",
        )


def too_close(spec: CheckContext) -> Found:
    """Warn of starts or targets nearer to each other than the lab's least separation."""
    per_mm = 1e-3 / spec.setup.metres
    for section, lab in (("plant", spec.experiment.plant), ("lab", spec.experiment.lab)):
        if not isinstance(lab, LabSection):
            continue
        least = lab.limits.separation_mm
        for field, i, other, gap in nearest(spec.setup):
            if gap < least * per_mm:
                yield (
                    ("robots", i, field),
                    f"is {gap / per_mm:.4g} mm from the {field} of {other}; the lab aborts when "
                    f"robots come nearer than {least:.4g} mm",
                    f"move them apart, or lower {section}.limits.separation_mm",
                )


def same_place(spec: CheckContext) -> Found:
    """Warn of the first two equal starts, and the first two targets where robots overlap."""
    told, body = set[str](), 2 * spec.keeps.radius if spec.keeps else 0.0
    for field, i, other, gap in nearest(spec.setup):
        if (gap == 0 or gap < body) and field not in told:
            told.add(field)
            where = f"is {gap:.4g} {spec.unit} from the {field} of {other}"
            yield ("robots", i, field), f"{where}: both cannot stand there", "move one of them"


def hold_too_tight(spec: CheckContext) -> Found:
    """Warn of a hold within less than v / a of robots that cannot stand still."""
    setup = spec.setup
    if setup.hold is None or setup.wheel_radius is not None:
        return
    for name, least in zip(setup.names, (setup.speed / setup.a).tolist(), strict=True):
        if setup.hold.radius < least:
            text = f"is less than v / a of {name}, {least:.4g} {spec.unit}, its least mean distance"
            yield ("hold", "radius"), text, "ask for more, or for a stronger field"


SPEC_CHECKS: tuple[Callable[[CheckContext], Found], ...] = (
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
    too_close,
    same_place,
    hold_too_tight,
)


@dataclass(frozen=True, slots=True)
class PlacedWarning(SpecProblem):
    """A warning with the file and the line of the value that it concerns."""

    hint: str = ""

    def __str__(self) -> str:
        return f"{SpecProblem.__str__(self)}; {self.hint}"


@np.errstate(all="ignore")  # very large values may overflow
def find_warnings(loaded: LoadedSpec, sets: Sequence[str] = ()) -> tuple[PlacedWarning, ...]:
    """Return the warnings of a spec that was loaded with `sets`, in the order of its lines."""
    if loaded.experiment.open:  # its robots are placeholders
        return ()
    context = CheckContext(loaded.experiment)
    warnings = [each for check in SPEC_CHECKS for each in check(context)]
    if not warnings:
        return ()
    document = document_of(loaded.text, str(loaded.path or loaded.name), sets)
    found: list[PlacedWarning] = []
    for loc, message, hint in warnings:
        place = document.place(loc)
        found.append(PlacedWarning(**asdict(place.problem(loc, message, place.text)), hint=hint))
    return tuple(sorted(found, key=lambda w: (w.line is None, w.line or 0, w.column or 0)))
