"""Amoudruz, Koumoutsakos: Independent control of two magnetic helices, arXiv 2101.10628.

The helices have step-outs of 69.8 and 28.6 rad/s; k is assumed to be 1 um per radian for both. The
legs of the closed form are planned again from the measured positions every PERIOD_S, and the first
is held for that long or to its end, until both helices are at their goals. Its least time is that
of the true values. Direction and frequency are a signal of their own: see the page.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.reproduce.paper import Fate, Figure, Paper, Work, at_least, at_most, mean
from tetractl.reproduce.roller_plan import RollerLeg, Rollers

PERIOD_S, LIMIT_S = 0.1, 300.0
NAMES, K, STEP_OUT = ("one", "two"), np.ones(2), np.array([69.8, 28.6])
OF_K, OF_STEP_OUT, NOISE, WANDER = 0.05, 0.02, 1.0, 1.0
"""Assumed: greatest relative errors of k and step-out, deviation of measured positions [um], and
wander [um/sqrt(s)]."""
ACCEPT = {False: 1e-3, True: 5.0}
"""Accepted distance from a goal [um], undisturbed and disturbed."""
GOALS_UM = 300.0
"""Standard deviation of x and y of the goals [um]."""


def drive(goals: Floats, rng: np.random.Generator, disturbed: bool, share: float = 1.0) -> float:
    """Return the time to the goals (2, 2) [um] over the least time, infinite after LIMIT_S.

    The field has frequencies of `share` times the step-outs that the controller knows.
    """
    errors = disturbed * rng.uniform(-1, 1, (2, 2))
    true = Rollers(NAMES, K * (1 + OF_K * errors[0]), STEP_OUT * (1 + OF_STEP_OUT * errors[1]))
    known = Rollers(NAMES, K, share * STEP_OUT)
    least = sum(leg.seconds for leg in true.plan(goals))
    at, seconds = np.zeros((2, 2)), 0.0
    while seconds < LIMIT_S:
        gap = goals - (at + disturbed * NOISE * rng.standard_normal((2, 2)))
        if np.hypot(*gap.T).max() < ACCEPT[disturbed]:
            return seconds / least
        leg = known.plan(gap)[0]
        held_s = min(PERIOD_S, leg.seconds)
        at = at + true.moved(RollerLeg(leg.direction, leg.frequency, held_s))
        at = at + disturbed * WANDER * math.sqrt(held_s) * rng.standard_normal((2, 2))
        seconds += held_s
    return math.inf


def along_axes(goals: Floats) -> float:
    """Return the time of the closed form as published, along the best pair of axes, over that along
    free directions."""
    plan = Rollers(NAMES, K, STEP_OUT).plan(goals)
    legs = np.array([[leg.seconds * f(leg.direction) for f in (np.cos, np.sin)] for leg in plan])
    turn = np.linspace(0, np.pi / 2, 1001)
    axes = np.stack([np.cos(turn), np.sin(turn)]), np.stack([-np.sin(turn), np.cos(turn)])
    times = sum(np.abs(legs @ axis).sum(axis=0) for axis in axes)
    return float(np.min(times) / np.hypot(*legs.T).sum())


def goal(seed: int, number: int) -> dict[str, float]:
    """Return times over the least time, to one pair of random goals."""
    rng = np.random.default_rng([seed, number])
    goals = rng.normal(0, GOALS_UM, (2, 2))
    return {
        "undisturbed": drive(goals, rng, False),
        "at the step-outs": drive(goals, rng, True),
        "below the step-outs": drive(goals, rng, True, 1 - OF_STEP_OUT),
        "along axes": along_axes(goals),
    }


def _figures(found: Mapping[str, Sequence[Mapping[str, float]]]) -> Iterator[Figure]:
    goals = found["goals"]
    what, least = "time to two goals, over the closed form", "1 (at most 1.05)"

    def times(kind: str) -> list[float]:
        return [one[kind] for one in goals]

    yield mean(f"{what}, undisturbed", least, times("undisturbed"), at_most(1.05))
    yield mean(
        f"{what}, disturbed, at the step-outs",
        least,
        times("at the step-outs"),
        at_most(1.05),
        Fate.MISSED,
        "above its true step-out, wrong by up to 2 %, a helix loses up to a fifth of its speed",
    )
    yield mean(
        f"{what}, disturbed, at 98 % of the step-outs",
        least,
        times("below the step-outs"),
        at_most(1.05),
    )
    yield mean(
        "time of the plan along two axes, over that along free directions",
        "that plan is the quickest along two axes",
        times("along axes"),
        at_least(1),
    )
    yield _equal_step_outs()


def _equal_step_outs() -> Figure:
    what, published = "equal step-outs", "no independent control"
    try:
        Rollers(NAMES, K, STEP_OUT[[1, 1]]).plan(np.ones((2, 2)))
    except UsageError as error:
        fate, why = Fate.REACHED, error.message
    else:
        fate, why = Fate.MISSED, ""
    return Figure(
        what, published, "yes", "refused" if why else "", 1, "none", fate, Fate.REACHED, why
    )


PAPER = Paper(
    "Amoudruz and Koumoutsakos, 2021: two helices, one rotating field (simulation of its own)",
    {},
    _figures,
    {"goals": Work(goal)},
)
