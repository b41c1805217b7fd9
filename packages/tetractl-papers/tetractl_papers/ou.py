"""Claims of Ou, Kang, Kim and Julius: PSO-MPC steers several T. pyriformis cells with one signal.

This is the paper that tetractl implements. The module lists it claim by claim, except for two
figures: Figure 4 shows a robot, and Figure 2 a swarm. The controller runs exactly as published. A
statement without a number becomes a plain comparison. Each number appears only once, because others
follow from
it: the error of one robot is a third of the total error, and the error of a cell is the same,
scaled by the speeds.
"""

import math

from tetractl_papers import ou_measures as measures
from tetractl_papers.claim import (
    Claim,
    Fate,
    at_least,
    at_most,
    deviation_of,
    mean_of,
    not_judged,
    rarely,
    same_number,
    share_of,
)
from tetractl_papers.paper import Paper, Runs

AS_PUBLISHED = "controller={type: pso-mpc, horizon_max: 70, obstacle_weight: 5000, time_limit: 60}"
EARLIER = "controller={type: ensemble, arrival_tolerance: 20, time_limit: 400}"
UNDISTURBED = "plant.motion=euler"
"""Setting with which the plant moves by the equations (4)-(6).

The controller predicts with the same equations.
"""
FIRST_SEARCH = (
    UNDISTURBED,
    "controller.steps_max=1",
    "controller.optimizer.stop={type: budget}",
)
"""Settings with which only the searches of step 0 run, with all 100 iterations."""
SQUARE_SIDES_DEG = (90, 180, -90, 0)
"""The directions of section IV-B.1, a quarter turn apart, for robots that start at 0.

A robot follows the same curve on each side, turned by a quarter: it ends where it began, except for
about exp(-a side) of a side.
"""
SQUARE_SIDE_STEPS = 10
"""Each side takes 2 s, in periods of 0.2 s: several times 1/a."""
SQUARE = (
    "controller={type: sequence, directions: ["
    + ", ".join(
        f"{math.radians(side)}" for side in SQUARE_SIDES_DEG for _ in range(SQUARE_SIDE_STEPS)
    )
    + "]}"
)

ARMS = {
    "figure-1": Runs("round_obstacle", trials=100),
    "swarm-1000": Runs("round_obstacle", ("controller.optimizer.particles=1000",)),
    "swarm-10000": Runs("round_obstacle", ("controller.optimizer.particles=10000",), 5),
    "first-search": Runs("three_m3pi_paper", FIRST_SEARCH),
    "open-undisturbed": Runs("three_m3pi_paper", (UNDISTURBED,), plans_of="first-search"),
    "bench": Runs("three_m3pi_paper_bench", trials=100),
    "open-bench": Runs("three_m3pi_paper_bench", trials=100, plan_of="first-search"),
    "square": Runs("three_m3pi_paper_bench", (SQUARE,)),
    "ensemble": Runs("three_m3pi_paper_bench", (EARLIER,), 100),
    "cells": Runs("benchmark/cells-flow", (AS_PUBLISHED,)),
}

ONE_PERIOD_MM = (180 + 200 + 150) * 0.2
"""Distance that the three robots drive together in one control period [mm].

"At the targets" cannot mean a smaller total error than about this distance.
"""
PUBLISHED_MEAN = "648.6 mm (543.2 to 754.0, n 20); 858.8 mm in the run of Fig. 5"
PUBLISHED_DEVIATION = "225.1 mm (171.2 to 328.8, n 20)"
"""With their 95 % intervals, of normal values: Student's t, and chi-square."""

AS_PRINTED = (
    "criterion (20) as printed is met at its first test, in iteration 11, because an iteration "
    "without improvement adds log 0"
)
SMALLER = "we do not know the delays and errors of the paper's lab"
SAMPLES = "equation (13) tests the predicted positions, not the path between them"
NO_EDGE = "the cost (7) has no term for the edge of the field of view"
THAN_EARLIER = "PSO-MPC minus Feedback Ensemble Control"

SIMULATED = [
    Claim(
        figure="Fig. 1: the robots reach their targets; total error at the end",
        published=f"only drawn; we read it as {ONE_PERIOD_MM:.0f} mm or less",
        arm="figure-1",
        measure=measures.total_error,
        unit="mm",
        asked=at_most(ONE_PERIOD_MM),
    ),
    Claim(
        figure="Fig. 1: trials in which a robot enters the disc",
        published="in none; one run",
        arm="figure-1",
        measure=measures.entered,
        asked=rarely(),
    ),
    Claim(
        figure="Fig. 3: iteration in which criterion (20) is met, 100 particles",
        published="20",
        arm="figure-1",
        measure=measures.iterations,
        asked=same_number(20),
        expected=Fate.MISSED,
        why=AS_PRINTED,
    ),
    Claim(
        figure="Fig. 3: iteration in which criterion (20) is met, 1,000 particles",
        published="20",
        arm="swarm-1000",
        measure=measures.iterations,
        asked=same_number(20),
        expected=Fate.MISSED,
        why=AS_PRINTED,
    ),
    Claim(
        figure="Fig. 3: iteration in which criterion (20) is met, 10,000 particles",
        published="20",
        arm="swarm-10000",
        measure=measures.iterations,
        asked=same_number(20),
        expected=Fate.MISSED,
        why=AS_PRINTED,
    ),
    Claim(
        figure="Fig. 3: J falls exponentially; R^2 of a line through log J, minus R^2 of a line "
        "through J",
        published="no number is given; above 0",
        arm="first-search",
        measure=measures.exponential,
        asked=at_least(0),
    ),
    Claim(
        figure="Fig. 3: J falls quickly at first; fraction of its fall in the first 10 of 100 "
        "iterations",
        published="no number is given; above 0.1",
        arm="first-search",
        measure=measures.early_share,
        asked=at_least(0.1),
    ),
    Claim(
        figure="Sections II to IV: the search finds nearly the smallest J, which is at least 0; "
        "J of step 0",
        published=f"no number is given; we read it as {ONE_PERIOD_MM:.0f} mm or less",
        arm="first-search",
        measure=measures.first_cost,
        unit="mm",
        asked=at_most(ONE_PERIOD_MM),
    ),
    Claim(
        figure="Section III: without errors, the sequence of step 0 is enough; its total error "
        "in open loop",
        published=f"no number is given; we read it as {ONE_PERIOD_MM:.0f} mm or less",
        arm="open-undisturbed",
        measure=measures.total_error,
        unit="mm",
        asked=at_most(ONE_PERIOD_MM),
    ),
    Claim(
        figure="Section III: with errors, it is not enough; total error on the bench, closed "
        "loop minus open loop",
        published="less; no number is given",
        arm="bench",
        minus="open-bench",
        measure=measures.total_error,
        unit="mm",
        asked=at_most(0),
    ),
    Claim(
        figure="Section IV-B: a warm start is a good guess; J of a step in the middle of a trial "
        "on the bench, minus J of 51 lengths searched without a warm start",
        published="no number is given; 0 or less",
        arm="bench",
        measure=measures.warm_gain,
        unit="mm",
        asked=at_most(0),
        expected=Fate.MISSED,
        why="three searches from a warm start need only 6 % of the evaluations, but find a "
        "higher J",
    ),
    Claim(
        figure="Section IV-B: the square of the first search ends at the starts; distance of a "
        "robot from its start",
        published=f"no number is given; we read it as {ONE_PERIOD_MM / 3:.0f} mm or less",
        arm="square",
        measure=measures.off_start,
        unit="mm",
        asked=at_most(ONE_PERIOD_MM / 3),
    ),
]


EXPERIMENT = [
    Claim(
        figure="mean total error of the 20 trials, on the bench",
        published=PUBLISHED_MEAN,
        arm="bench",
        measure=measures.total_error,
        unit="mm",
        asked=not_judged(mean_of),
        expected=Fate.NOT_JUDGED,
        why=SMALLER,
    ),
    Claim(
        figure="standard deviation of the total error of the 20 trials, on the bench",
        published=PUBLISHED_DEVIATION,
        arm="bench",
        measure=measures.total_error,
        unit="mm",
        asked=not_judged(deviation_of),
        expected=Fate.NOT_JUDGED,
        why=SMALLER,
    ),
    Claim(
        figure="Fig. 5: trials in which a robot enters the square, on the bench",
        published="in none; one run",
        arm="bench",
        measure=measures.entered,
        asked=not_judged(share_of),
        expected=Fate.NOT_JUDGED,
        why=SAMPLES,
    ),
    Claim(
        figure="Fig. 5: trials in which a robot leaves the field of view of 1600 x 1800 mm, on "
        "the bench",
        published="not stated",
        arm="bench",
        measure=measures.left,
        asked=not_judged(share_of),
        expected=Fate.NOT_JUDGED,
        why=NO_EDGE,
    ),
]

CELLS = [
    Claim(
        figure="Section V: error of a cell, with three simulated cells",
        published="about 400 um",
        arm="cells",
        measure=measures.error_of_a_robot,
        unit="um",
        asked=not_judged(mean_of),
        expected=Fate.NOT_JUDGED,
    ),
]

EARLIER_METHOD = [
    Claim(
        figure=f"Section I: total error, {THAN_EARLIER}",
        published="less; no number is given",
        arm="bench",
        minus="ensemble",
        measure=measures.total_error,
        unit="mm",
        asked=at_most(0),
    ),
    Claim(
        figure=f"Section I: space, divided by the space of starts and targets, {THAN_EARLIER}",
        published="less; no number is given",
        arm="bench",
        minus="ensemble",
        measure=measures.space,
        asked=at_most(0),
        expected=Fate.MISSED,
        why="with three robots, both methods need about the same space, or PSO-MPC a little more",
    ),
    Claim(
        figure='Section I: "we will not generate the rotating magnetic field"; trials in which '
        "it rotates",
        published="never",
        arm="bench",
        measure=measures.spinning,
        asked=rarely(),
        expected=Fate.MISSED,
        why="nothing in the cost (7) keeps the direction from turning through a whole turn",
    ),
    Claim(
        figure=f"Section I: time for which the field rotates, {THAN_EARLIER}",
        published="less; no number is given",
        arm="bench",
        minus="ensemble",
        measure=measures.spinning,
        unit="s",
        asked=at_most(0),
    ),
]

PAPER = Paper(
    source="Ou, Kang, Kim and Julius, the paper of PSO-MPC (simulation)",
    arms=ARMS,
    claims=[*SIMULATED, *EXPERIMENT, *CELLS, *EARLIER_METHOD],
)
