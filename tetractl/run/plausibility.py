"""Warns of problems in a valid spec that may prevent a trial from working as intended. Each check
is a function in `CHECKS` that yields a `SpecWarning` for each problem and states its numbers.
docs/reference/warnings.md explains the warnings.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import BaseModel

from tetractl.core.poses import Floats, wrap
from tetractl.core.setup import Setup
from tetractl.experiment.consistency import nearest
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import LoadedSpec, document_of
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
TURN = 2 * math.pi
ALIKE = 0.05
"""Robots are alike if their turning rates a differ by at most this fraction, and their start
headings by at most this number of radians."""


@dataclass(frozen=True, slots=True)
class SpecWarning:
    """A warning of a check: the field, a message and a hint."""

    loc: Loc
    message: str
    hint: str


@dataclass(frozen=True)
class CheckContext:
    """An experiment, and data of its controller for the checks. `signals_max` is None if the length
    of plans is not limited; `motion` is "" if the controller has no model of the motion.
    """

    experiment: Experiment
    setup: Setup
    signal_s: float  # time for which a signal of a plan is held
    signals_max: int | None
    motion: str
    radius: float  # of a robot's body, 0 if unknown
    margin: float  # distance that plans keep to obstacles, including a robot's radius
    yields: bool  # whether the margin is reduced at starts and targets
    walls: bool
    tolerance: float

    @classmethod
    def of(cls, experiment: Experiment) -> "CheckContext":
        """Return the data of an experiment for the checks."""
        control: Any = experiment.controller
        collision = getattr(control, "collision", None)
        return cls(
            experiment=experiment,
            setup=experiment.setup,
            signal_s=getattr(control, "signal_periods", 1) * control.period,
            signals_max=getattr(control, "horizon_max", None),
            motion=getattr(control, "motion", ""),
            radius=collision.radius if collision else 0.0,
            margin=collision.margin + collision.radius if collision else 0.0,
            yields=collision.adaptive if collision else False,
            walls=collision.walls if collision else False,
            tolerance=control.arrival_tolerance,
        )

    @property
    def unit(self) -> str:
        """The length unit of the experiment."""
        return self.setup.unit

    @property
    def longest_s(self) -> float:
        """The longest time for which robots move in a trial [s]."""
        return (self.setup.steps_max + 1) * self.setup.period_s

    @cached_property
    def least_total_error(self) -> float:
        """A lower bound of the total error of any plan [length unit], see `model.bounds`."""
        return bounds.least_total_error(self.setup, self.longest_s)


def angles(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of angles of more than a whole turn, which are probably degrees."""
    for loc, value in _radians(spec.experiment, ()):
        if abs(value) > TURN:
            yield SpecWarning(
                loc,
                "is more than a whole turn, 6.283 rad",
                f"if these are degrees, write {math.radians(value):.4g}",
            )


def _radians(part: BaseModel, loc: Loc) -> Iterator[tuple[Loc, float]]:
    """Yield location and value of each number in those fields of a section described in [rad]."""
    for name, field in type(part).model_fields.items():
        value = getattr(part, name)
        for step, item in enumerate(value) if isinstance(value, tuple) else [(None, value)]:
            at = (*loc, name) if step is None else (*loc, name, step)
            if isinstance(item, BaseModel):
                yield from _radians(item, at)
            elif isinstance(item, float) and "[rad]" in (field.description or ""):
                yield at, item


def plan_outlasts_trial(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of plans that take longer than a trial."""
    if spec.signals_max is None:
        return
    seconds = spec.signals_max * spec.signal_s
    if seconds > spec.longest_s * (1 + 1e-9):
        yield SpecWarning(
            ("controller", "horizon_max"),
            f"plans of {seconds:.4g} s outlast the trial, which ends after steps_max + 1 control "
            f"steps, {spec.longest_s:.4g} s",
            "raise controller.steps_max, or lower horizon_max to "
            f"{max(int(spec.longest_s / spec.signal_s * (1 + 1e-9)), 1)}",
        )


def coarse_period(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn if signals are held so long that robots finish turning, or overshoot."""
    turned = spec.setup.a * spec.signal_s
    quick = np.flatnonzero(turned > COARSE)
    if not quick.size:
        return
    i = int(turned.argmax())
    if spec.motion in OVERSHOOTING:
        effect = "by equation (6) its heading overshoots a held direction further at each step"
    elif len(quick) > 1:
        slowest = float(turned[quick].min())
        effect = (
            f"{len(quick)} robots make {-100 * math.expm1(-slowest):.3g} % or more of a turn in T"
        )
    else:  # the motion is exact for any period, and one fast robot differs from the others
        return
    yield SpecWarning(
        ("controller", "period"),
        f"a T = {turned[i]:.3g} for {spec.setup.names[i]}, with signals held for T = "
        f"{spec.signal_s:.4g} s, is above 2: {effect}",
        f"hold signals for less than {COARSE / spec.setup.a[i]:.3g} s",
    )


def unknown_dead_time(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of a plant whose dead time differs from the controller's by more than a control period,
    unless the controller identifies it.
    """
    true = getattr(spec.experiment.plant, "dead_time", None)
    assumed = getattr(spec.experiment.controller, "dead_time", 0.0)
    period, identified = (
        spec.setup.period_s,
        getattr(spec.experiment.controller, "estimate", False),
    )
    if true is not None and not identified and abs(true - assumed) > period:
        yield SpecWarning(
            ("plant", "dead_time"),
            f"is {true:.4g} s, but the controller assumes {assumed:.4g} s: every command acts "
            f"{abs(true - assumed) / period:.2g} control periods too early or late",
            f"set controller.dead_time to {true:.4g}",
        )


def out_of_reach(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of targets that a robot cannot reach in a trial, even along a straight line."""
    for i, left in enumerate(reach(spec.setup, spec.longest_s)):
        if left > spec.tolerance:
            yield SpecWarning(
                ("robots", i, "target"),
                f"is {_way(spec, i)} away; in the {spec.longest_s:.4g} s of a trial the robot "
                f"drives {spec.setup.speed[i] * spec.longest_s:.4g} {spec.unit}, "
                f"{left:.4g} too few",
                "raise controller.steps_max, or bring the target nearer",
            )


def beyond_the_plan(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of targets that a robot can reach in a trial, but not in the longest plan."""
    if spec.signals_max is None:
        return
    seconds = spec.signals_max * spec.signal_s
    left = reach(spec.setup, seconds)
    far = (left > spec.tolerance) & (reach(spec.setup, spec.longest_s) <= spec.tolerance)
    if not far.any():
        return
    speed = np.where(far, spec.setup.speed, 1.0)
    needed = np.where(far, left / speed + seconds, 0.0)
    i = int(needed.argmax())
    yield SpecWarning(
        ("controller", "horizon_max"),
        f"{spec.setup.names[i]} is {_way(spec, i)} from its target; in {spec.signals_max} signals, "
        f"{seconds:.4g} s, it drives {speed[i] * seconds:.4g} {spec.unit}, {left[i]:.4g} too few",
        f"set it to more than {math.ceil(needed[i] / spec.signal_s)}",
    )


def _way(spec: CheckContext, i: int) -> str:
    gap = float(np.linalg.norm(spec.setup.targets[i] - spec.setup.starts.xy[i]))
    return f"{gap:.4g} {spec.unit}"


def robots_alike(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of robots that one signal cannot separate, though their targets require it."""
    for group in _alike(spec.setup):
        some = spec.setup.only(group)
        least = bounds.least_total_error(some, spec.longest_s, alike=True)
        if least <= max(len(group) * spec.tolerance, 1e-6 * _size(spec.setup)):
            continue
        first, *others = (spec.setup.names[i] for i in group)
        spread = float(np.ptp(some.a) / some.a.mean())
        turned = float(np.abs(wrap(some.starts.heading - some.starts.heading[0])).max())
        if spread == 0 and turned < 1e-9:
            message = (
                f"is that of {first}, and so is the start heading: {_and(others)} can only move "
                f"in parallel, and the least total error of the {len(group)} is"
            )
        else:
            message = (
                f"{_and(others)} and {first} differ by {100 * spread:.2g} % in turning rate a and "
                f"{turned:.2g} rad in start heading, perhaps too little to separate them: if "
                f"they did not differ, the least total error of the {len(group)} would be"
            )
        yield SpecWarning(
            ("robots", group[1], "a"),
            f"{message} {least:.4g} {spec.unit}",
            "give them different a, or targets with the same relative positions as the starts",
        )


def _and(names: Sequence[str]) -> str:
    """Return names joined by commas and "and"; of more than three names, two and "N more"."""
    shown = list(names) if len(names) < 4 else [*names[:2], f"{len(names) - 2} more"]
    return " and ".join(filter(None, [", ".join(shown[:-1]), shown[-1]]))


def _alike(setup: Setup) -> Iterator[list[int]]:
    """Yield groups of robots that are like the group's first in turning rate and start heading."""
    left = np.ones(len(setup.a), dtype=np.bool_)
    for i in range(len(setup.a)):
        if not left[i]:
            continue
        near = np.abs(setup.a - setup.a[i]) <= ALIKE * np.maximum(setup.a, setup.a[i])
        near &= np.abs(wrap(setup.starts.heading - setup.starts.heading[i])) <= ALIKE
        group = np.flatnonzero(near & left)
        left[group] = False
        if len(group) > 1:
            yield group.tolist()


def error_left(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn if no plan can reach all targets: the lower bound of the total error is not 0."""
    least = spec.least_total_error
    count = len(spec.setup.a)
    if least > max(count * spec.tolerance, 1e-6 * _size(spec.setup)):
        yield SpecWarning(
            ("robots",),
            f"least total error of any plan: {least:.4g} {spec.unit}",
            "no controller can do better with these a, speeds, starts and targets",
        )


def _size(setup: Setup) -> float:
    return max(setup.arena.width, setup.arena.height)


def walled_off(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of targets to which no path leads past the obstacles, or no path with the margin."""
    if not spec.experiment.obstacles:
        return
    apart = shut_out(spec.setup, 0.0, spec.walls)
    for i in np.flatnonzero(apart > 0):
        yield SpecWarning(
            ("robots", int(i), "target"),
            f"is walled off: the robot comes no nearer than {apart[i]:.4g} {spec.unit}",
            "open a gap between the obstacles",
        )
    if spec.margin > 0:
        squeezed = shut_out(spec.setup, spec.margin, spec.walls)
        ends = np.minimum(
            *(_clearances(spec, xy) for xy in (spec.setup.starts.xy, spec.setup.targets))
        )
        for i in np.flatnonzero((squeezed > 0) & (apart == 0) & (ends > spec.margin)):
            yield SpecWarning(
                ("robots", int(i), "target"),
                f"has no path to it that keeps {spec.margin:.4g} {spec.unit} from the obstacles: "
                f"the robot comes within {squeezed[i]:.4g} {spec.unit}",
                "lower controller.collision.margin or radius, or widen the gap",
            )


def inside_margin(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of starts and targets that are nearer to an obstacle than the planner's margin."""
    if spec.margin == 0 or spec.yields:
        return
    for field, points in (("start", spec.setup.starts.xy), ("target", spec.setup.targets)):
        gaps = _clearances(spec, points)
        for i in np.flatnonzero(gaps <= spec.margin):
            yield SpecWarning(
                ("robots", int(i), field),
                f"is {gaps[i]:.4g} {spec.unit} from the nearest obstacle or wall; plans keep "
                f"{spec.margin:.4g} {spec.unit}",
                "move it, or lower controller.collision.margin or radius",
            )


def _clearances(spec: CheckContext, points: Floats) -> Floats:
    return clearance(spec.setup, points[:, 0], points[:, 1], spec.walls)


def too_close(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of starts or targets nearer to each other than the lab's least separation."""
    setup = spec.setup
    for section in ("plant", "lab"):
        limits = getattr(getattr(spec.experiment, section), "limits", None)
        if limits is None:
            continue
        per_mm = 1e-3 / setup.metres
        least = limits.separation_mm * per_mm
        for field, i, other, gap in nearest(setup):
            if gap < least:
                yield SpecWarning(
                    ("robots", i, field),
                    f"is {gap / per_mm:.4g} mm from the {field} of {other}; the lab aborts when "
                    f"robots come nearer than {limits.separation_mm:.4g} mm",
                    f"move them apart, or lower {section}.limits.separation_mm",
                )


def same_place(spec: CheckContext) -> Iterator[SpecWarning]:
    """Warn of the first two equal starts, and the first two targets where robots overlap."""
    told = set()
    for field, i, other, gap in nearest(spec.setup):
        if (gap == 0 or gap < 2 * spec.radius) and field not in told:
            told.add(field)
            yield SpecWarning(
                ("robots", i, field),
                f"is {gap:.4g} {spec.unit} from the {field} of {other}: both cannot stand there",
                "move one of them",
            )


CHECKS: tuple[Callable[[CheckContext], Iterator[SpecWarning]], ...] = (
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
    too_close,
    same_place,
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
    context = CheckContext.of(loaded.experiment)
    document = document_of(loaded.text, str(loaded.path or loaded.name), sets)
    found = []
    for warning in (warning for check in CHECKS for warning in check(context)):
        place = document.place(warning.loc)
        at = place.problem(warning.loc, warning.message, place.text)
        found.append(
            PlacedWarning(
                at.origin, at.message, at.line, at.column, at.field, at.value, warning.hint
            )
        )
    return tuple(sorted(found, key=lambda w: (w.line is None, w.line or 0, w.column or 0)))
