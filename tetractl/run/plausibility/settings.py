"""Checks of single numbers: angles in degrees, and times that do not fit each other."""

import math
from collections.abc import Iterator

import numpy as np
from pydantic import BaseModel

from tetractl.experiment.yaml.problems import Loc
from tetractl.run.plausibility.case import Case, Doubt

COARSE = 2.0
"""a T beyond which the headings of (6) overshoot further at every step."""
OVERSHOOTING = ("euler", "arc")
"""The motions whose heading advances by (6)."""
TURN = 2 * math.pi


def angles(case: Case) -> Iterator[Doubt]:
    """Angles beyond a whole turn, which look like degrees."""
    for loc, value in _radians(case.experiment, ()):
        if abs(value) > TURN:
            yield Doubt(
                loc,
                "is more than a whole turn, 6.283 rad",
                f"if these are degrees, write {math.radians(value):.4g}",
            )


def _radians(part: BaseModel, loc: Loc) -> Iterator[tuple[Loc, float]]:
    """Yield every number of a section, and of those in it, whose description says [rad]."""
    for name, field in type(part).model_fields.items():
        value = getattr(part, name)
        for step, item in enumerate(value) if isinstance(value, tuple) else [(None, value)]:
            at = (*loc, name) if step is None else (*loc, name, step)
            if isinstance(item, BaseModel):
                yield from _radians(item, at)
            elif isinstance(item, float) and "[rad]" in (field.description or ""):
                yield at, item


def plan_outlasts_trial(case: Case) -> Iterator[Doubt]:
    """Plans that are longer than a trial."""
    if case.signals_max is None:
        return
    seconds = case.signals_max * case.signal_s
    if seconds > case.longest_s * (1 + 1e-9):
        yield Doubt(
            ("controller", "horizon_max"),
            f"plans of {seconds:.4g} s outlast the trial, which ends after steps_max + 1 control "
            f"steps, {case.longest_s:.4g} s",
            "raise controller.steps_max, or lower horizon_max to "
            f"{max(int(case.longest_s / case.signal_s * (1 + 1e-9)), 1)}",
        )


def coarse_period(case: Case) -> Iterator[Doubt]:
    """Signals held so long that robots have turned, or have overshot, before the next."""
    turned = case.setup.a * case.signal_s
    quick = np.flatnonzero(turned > COARSE)
    if not quick.size:
        return
    i = int(turned.argmax())
    if case.motion in OVERSHOOTING:
        effect = "by (6) it overshoots a held direction further at every step"
    elif len(quick) > 1:
        slowest = float(turned[quick].min())
        effect = (
            f"{len(quick)} robots do {-100 * math.expm1(-slowest):.3g} % of a turn or more in T"
        )
    else:  # predicted exactly for any period, and one quick robot still differs from the others
        return
    yield Doubt(
        ("controller", "period"),
        f"a T = {turned[i]:.3g} for {case.setup.names[i]}, with signals held for T = "
        f"{case.signal_s:.4g} s, is above 2: {effect}",
        f"hold signals for less than {COARSE / case.setup.a[i]:.3g} s",
    )


def unknown_dead_time(case: Case) -> Iterator[Doubt]:
    """A dead time that the controller is wrong about by over a control period, and not to find."""
    true = getattr(case.experiment.plant, "dead_time", None)
    believed = getattr(case.experiment.controller, "dead_time", 0.0)
    period, identified = case.setup.period_s, getattr(case.experiment.controller, "estimate", False)
    if true is not None and not identified and abs(true - believed) > period:
        yield Doubt(
            ("plant", "dead_time"),
            f"is {true:.4g} s and the controller counts on {believed:.4g} s: every command acts "
            f"{abs(true - believed) / period:.2g} control periods from when it is meant to",
            f"set controller.dead_time to {true:.4g}",
        )
