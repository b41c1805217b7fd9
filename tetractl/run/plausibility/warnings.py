"""Warns of what is doubtful in a spec.

Each check is a function in `CHECKS`: it yields a `Doubt`, with the number that shows it, for each
thing it finds. What each check means is in docs/reference/warnings.md.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.experiment.load import LoadedSpec, document_of
from tetractl.experiment.yaml.problems import SpecProblem
from tetractl.run.plausibility import places, robots, settings
from tetractl.run.plausibility.case import Case, Doubt

CHECKS: tuple[Callable[[Case], Iterator[Doubt]], ...] = (
    settings.angles,
    settings.plan_outlasts_trial,
    settings.coarse_period,
    settings.unknown_dead_time,
    robots.robots_alike,
    robots.out_of_reach,
    robots.beyond_the_plan,
    robots.error_left,
    places.walled_off,
    places.inside_margin,
    places.too_close,
)


@dataclass(frozen=True, slots=True)
class SpecWarning(SpecProblem):
    """A doubt at its place in the spec's file."""

    hint: str = ""

    def __str__(self) -> str:
        return f"{SpecProblem.__str__(self)}; {self.hint}"


@np.errstate(all="ignore")  # absurd numbers are a spec's own affair
def find_warnings(loaded: LoadedSpec, sets: Sequence[str] = ()) -> tuple[SpecWarning, ...]:
    """Return what is doubtful in a spec that was loaded with `sets`, in the order of its lines."""
    case = Case.of(loaded.experiment)
    document = document_of(loaded.text, str(loaded.path or loaded.name), sets)
    found = []
    for doubt in (doubt for check in CHECKS for doubt in check(case)):
        place = document.place(doubt.loc)
        at = place.problem(doubt.loc, doubt.message, place.text)
        found.append(
            SpecWarning(at.origin, at.message, at.line, at.column, at.field, at.value, doubt.hint)
        )
    return tuple(sorted(found, key=lambda w: (w.line is None, w.line or 0, w.column or 0)))
