"""Warns of what is doubtful in a spec.

Each check is a function in `CHECKS`. What each check means is in docs/reference/warnings.md.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.experiment.load import LoadedSpec, document_of
from tetractl.experiment.yaml.problems import SpecProblem
from tetractl.run.plausibility import checks
from tetractl.run.plausibility.context import CheckContext, SpecWarning

CHECKS: tuple[Callable[[CheckContext], Iterator[SpecWarning]], ...] = (
    checks.angles,
    checks.plan_outlasts_trial,
    checks.coarse_period,
    checks.unknown_dead_time,
    checks.robots_alike,
    checks.out_of_reach,
    checks.beyond_the_plan,
    checks.error_left,
    checks.walled_off,
    checks.inside_margin,
    checks.too_close,
)


@dataclass(frozen=True, slots=True)
class PlacedWarning(SpecProblem):
    """A warning at its place in the spec's file."""

    hint: str = ""

    def __str__(self) -> str:
        return f"{SpecProblem.__str__(self)}; {self.hint}"


@np.errstate(all="ignore")  # absurd numbers are a spec's own affair
def find_warnings(loaded: LoadedSpec, sets: Sequence[str] = ()) -> tuple[PlacedWarning, ...]:
    """Return what is doubtful in a spec that was loaded with `sets`, in the order of its lines."""
    if loaded.experiment.open:  # its robots are stand-ins
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
