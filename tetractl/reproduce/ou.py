"""Ou, Kang, Kim, Julius: motion control of several T. pyriformis cells by one signal, PSO-MPC.

The paper that tetractl implements, figure by figure; Figure 4 shows a robot. Its controller is run
exactly as published. What the paper states without a number is taken as the plain comparison.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from tetractl.core.table.table import digits
from tetractl.log.read.trial_log import TrialLog
from tetractl.reproduce import ou_measures as of
from tetractl.reproduce.paper import (
    Fate,
    Figure,
    Paper,
    Repeated,
    Requirement,
    Runs,
    at_least,
    at_most,
    mean,
    near,
    share,
    single,
)

AS_PUBLISHED = "controller={type: pso-mpc, horizon_max: 70, obstacle_weight: 5000, time_limit: 60}"
EARLIER = "controller={type: ensemble, arrival_tolerance: 20, time_limit: 400}"
LATE = (
    "plant.dead_time=0.15",
    "plant.a_error=0.1",
    "plant.speed_error=0.1",
    "plant.heading_noise=0.1",
    "plant.lost_commands=0.05",
)
"""Round values that give an error of the published size; none is published."""
ONCE = ("plant.motion=euler", "controller.steps_max=1", "controller.optimizer.stop={type: budget}")
"""Only the searches of step 0, with all 100 iterations."""
CASES = {"bench": "bench", "late": "harsher"}
PUBLISHED = Repeated(648.6, 225.1, 20)
CELL_SPEED, BODY_UM = 300.0, 50.0
"""The paper's speed [um/s] and body length [um] of a cell."""
MISSED, AGREES = Fate.MISSED, Fate.AGREES
Logs = Mapping[str, Sequence[TrialLog]]


def _first_plan(logs: Logs) -> tuple[str, ...]:
    """Return the plan of step 0 of the first `once` trial as a controller, to be sent open loop."""
    directions = logs["once"][0].steps[0].plan.signals.tolist()
    return (f"controller={{type: sequence, period: 0.2, directions: {directions}}}",)


def _simulated(logs: Logs) -> Iterator[Figure]:
    drawn, once = logs["figure-1"], logs["once"]
    way = 0.2 * sum(drawn[0].start.setup.speed)
    yield mean(
        "Fig. 1: robots reach their targets: total error",
        f"drawn; read as {way:.0f} mm or less",
        [*map(of.total_error, drawn)],
        at_most(way),
        unit="mm",
    )
    yield share("Fig. 1: the disc is entered", "not", [*map(of.entered, drawn)], 0)
    yield mean(
        "Fig. 3: iteration in which criterion (20) is met",
        "20",
        [*map(of.iterations, drawn)],
        near(20),
        MISSED,
        "as printed, (20) is met at its first test, iteration 11, in any unit and swarm tried",
    )
    yield mean(
        "Fig. 3: J falls exponentially: R^2 of a line through log J, minus that through J",
        "no number; above 0",
        [*map(of.exponential, once)],
        at_least(0),
    )
    yield mean(
        "Fig. 3: J falls quickly at first: share of the fall in 10 of 100 iterations",
        "no number; above 0.1",
        [*map(of.early_share, once)],
        at_least(0.1),
    )
    yield mean(
        "II to IV: J found is close to the least, which is 0 or more: J of step 0, 100 iterations",
        f"no number; read as {way:.0f} mm or less",
        [*map(of.first_cost, once)],
        at_most(way),
        unit="mm",
    )
    yield mean(
        "III: without errors, the sequence of step 0 is enough: its total error, open loop",
        f"no number; read as {way:.0f} mm or less",
        [log.steps[0].plan.target_cost for log in once],
        at_most(way),
        unit="mm",
    )
    open_loop, bench = logs["open"], logs["bench"]
    yield _against(
        "III: with errors, it is not: total error on the bench, closed minus open loop",
        bench,
        open_loop,
        of.total_error,
        "mm",
    )
    yield mean(
        "IV-B: warm start saves work: cost evaluations of a later step over those of step 0",
        "less, no number",
        [*map(of.warm_work, bench)],
        at_most(1),
    )
    yield mean(
        "IV-B: a square during the first search ends at the starts: distance of a robot, bench",
        f"no number; read as {way / 3:.0f} mm or less",
        [*map(of.off_start, logs["square"])],
        at_most(way / 3),
        unit="mm",
    )


def _experiment(logs: Logs) -> Iterator[Figure]:
    unknown = "the paper's delays and errors are unknown"
    for kind, case in CASES.items():
        late = kind == "late"
        runs, total = logs[kind], [*map(of.total_error, logs[kind])]
        yield mean(
            f"Fig. 5: total error of the run, {case}", "858.8 mm", total, at_most(858.8), unit="mm"
        )
        page = AGREES if late else MISSED
        smaller = "" if late else f"ours is smaller: {unknown}"
        yield single(f"Fig. 5: the same, {case}", 858.8, total, page, smaller, "mm")
        yield mean(
            f"Fig. 5: error of a robot, {case}",
            "about 280 mm",
            [one / 3 for one in total],
            at_most(858.8 / 3),
            unit="mm",
        )
        yield PUBLISHED.of_mean(f"20 trials: mean total error, {case}", total, page, smaller, "mm")
        yield PUBLISHED.of_deviation(
            f"20 trials: standard deviation of the total error, {case}", total, page, smaller, "mm"
        )
        yield share(
            f"Fig. 5: the square is entered, {case}",
            "not, in one run",
            [*map(of.entered, runs)],
            0,
            MISSED,
            "(13) tests the predicted samples, not the way between them",
        )
        yield share(
            f"Fig. 5: the field of view of 1600 x 1800 mm is left, {case}",
            "not stated",
            [*map(of.left, runs)],
            0,
            MISSED,
            "the cost (7) has no term for its edge",
        )


def _cells(logs: Logs) -> Iterator[Figure]:
    robots = logs["bench"][0].start.setup
    factor = CELL_SPEED / float(np.mean(robots.speed))
    scaled = [factor * one / 3 for one in (858.8, PUBLISHED.mean)]
    published = f"about 400 um; {scaled[0]:.0f} from 858.8 mm, {scaled[1]:.0f} from 648.6 mm"
    for kind, case in CASES.items():
        late = kind == "late"
        yield mean(
            f"V: error of a cell, scaled from robots by the speeds, {case}",
            published,
            [factor * of.total_error(log) / 3 for log in logs[kind]],
            near(400) if late else at_most(400),
            AGREES if late else Fate.REACHED,
            unit="um",
        )
    found = [of.total_error(log) / len(log.start.setup.names) for log in logs["cells"]]
    simulated = "V: error of a cell, three simulated cells"
    yield mean(simulated, "about 400 um", found, at_most(400), unit="um")
    yield mean(
        f"{simulated}, in body lengths",
        "about 8 body lengths",
        [one / BODY_UM for one in found],
        at_most(8),
    )
    side = np.sqrt(1600 * 1800) / float(np.mean(robots.speed)), 5000 / CELL_SPEED
    yield mean(
        "I: field of view over speed, cells over robots",
        "roughly the same; read as 0.8 to 1.25",
        [side[1] / side[0]],
        Requirement("agreement", lambda ci: ci.low >= 0.8 and ci.high <= 1.25, AGREES),
        MISSED,
        f"by the paper's numbers: {side[0]:.1f} s (root of the area) and {side[1]:.1f} s",
    )


def _earlier(logs: Logs) -> Iterator[Figure]:
    ours, earlier = logs["bench"], logs["ensemble"]
    than = "PSO-MPC minus Feedback Ensemble Control"
    yield _against(
        f"I: error of a robot, {than}", ours, earlier, lambda log: of.total_error(log) / 3, "mm"
    )
    yield _against(
        f"I: space, over that of starts and targets, {than}",
        ours,
        earlier,
        of.space,
        "",
        MISSED,
        "about the same space, or a little more, with three robots",
    )
    spins = [of.spinning(log) for log in ours]
    yield mean(
        'I: "we will not generate the rotating magnetic field": time for which it rotates',
        "0 s",
        spins,
        at_most(0),
        MISSED,
        f"in {sum(one > 0 for one in spins)} of {len(spins)} trials, at most {max(spins):.1f} s",
        "s",
    )
    yield _against(f"I: the same, {than}", ours, earlier, of.spinning, "s")


def _against(
    what: str,
    ours: Sequence[TrialLog],
    other: Sequence[TrialLog],
    measure: Callable[[TrialLog], float],
    unit: str,
    page: Fate = Fate.REACHED,
    why: str = "",
) -> Figure:
    """Return a figure of paired differences, ours minus the other's: below 0 is asked."""
    a, b = ([measure(log) for log in logs[: len(other)]] for logs in (ours, other))
    means = f"means {digits(float(np.mean(a)))} and {digits(float(np.mean(b)))} {unit}".strip()
    why = f"{means}: {why}" if why else means
    gaps = [one - than for one, than in zip(a, b, strict=True)]
    return mean(what, "less, no number", gaps, at_most(0), page, why, unit)


def _figures(logs: Logs) -> Iterator[Figure]:
    for part in (_simulated, _experiment, _cells, _earlier):
        yield from part(logs)


PAPER = Paper(
    "Ou, Kang, Kim and Julius, the paper of PSO-MPC (simulation)",
    {
        "figure-1": Runs("round_obstacle"),
        "once": Runs("three_m3pi_paper", ONCE),
        "bench": Runs("three_m3pi_paper_bench", trials=100),
        "late": Runs("three_m3pi_paper", LATE, 300),
        "open": Runs("three_m3pi_paper_bench", trials=100, then=_first_plan),
        "square": Runs("three_m3pi_paper_bench", ("controller.first_plan={type: square}",)),
        "ensemble": Runs("three_m3pi_paper_bench", (EARLIER,), 100),
        "cells": Runs("benchmark/cells-bench", (AS_PUBLISHED,)),
    },
    _figures,
)
