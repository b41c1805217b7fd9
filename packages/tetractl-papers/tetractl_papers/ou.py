"""Claims of a paper by Ou, Kang, Kim and Julius: PSO-MPC steers several cells with one signal.

This is the paper that tetractl implements. Its cells are T. pyriformis. The module lists every
claim of the paper, except for two figures: Figure 4 shows a robot, and Figure 2 a swarm. The
controller runs exactly as published. A statement without a number becomes a plain comparison. Each
number appears only once, because other numbers follow from it: the error of one robot is a third of
the total error, and the error of a cell is the same, scaled by the speeds.
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
ENSEMBLE_CONTROL = "controller={type: ensemble, arrival_tolerance: 20, time_limit: 400}"
UNDISTURBED = "plant.motion=euler"
"""Setting that makes the simulated robots move by equations (4)-(6), as the controller predicts."""
FIRST_SEARCH = (
    UNDISTURBED,
    "controller.steps_max=1",
    "controller.optimizer.stop={type: budget}",
)
"""Settings that run only the searches of step 0, each with all 100 iterations."""
SQUARE_SIDES_DEG = (90, 180, -90, 0)
"""Directions of the square in section IV-B.1, for robots that start with heading 0 [deg].

A robot follows the same curve on each side, rotated by a quarter turn. It therefore ends where it
started, except for about exp(-a T) of a side that takes the time T.
"""
SQUARE_SIDE_STEPS = 10
"""Number of control periods of a side of the square. A side takes 2 s, several times 1/a."""
SQUARE_SEQUENCE = (
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
    "square": Runs("three_m3pi_paper_bench", (SQUARE_SEQUENCE,)),
    "ensemble": Runs("three_m3pi_paper_bench", (ENSEMBLE_CONTROL,), 100),
    "cells": Runs("benchmark/cells-flow", (AS_PUBLISHED,)),
}

DISTANCE_PER_PERIOD_MM = (180 + 200 + 150) * 0.2
"""Sum of the distances that the three robots drive in one control period [mm].

Robots "at the targets" cannot be expected to have a smaller total error.
"""
PUBLISHED_MEAN = "648.6 mm (543.2 to 754.0, n 20); 858.8 mm in the run of Fig. 5"
PUBLISHED_DEVIATION = "225.1 mm (171.2 to 328.8, n 20)"
"""The published mean and standard deviation of the total error, with 95 % intervals.

The intervals assume normal values: Student's t for the mean, chi-square for the deviation.
"""

STOP_CRITERION_REASON = (
    "criterion (20) as printed is met at its first test, in iteration 11, because an iteration "
    "without improvement adds log 0"
)
UNKNOWN_LAB_REASON = "we do not know the delays and errors of the paper's lab"
SAMPLED_PATH_REASON = "equation (13) tests the predicted positions, not the path between them"
NO_EDGE_COST_REASON = "the cost (7) has no term for the edge of the field of view"
MINUS_ENSEMBLE = "PSO-MPC minus Feedback Ensemble Control"

SIMULATION_CLAIMS = [
    Claim(
        figure="Fig. 1: the robots reach their targets; total error at the end",
        published=f"only drawn; we read it as {DISTANCE_PER_PERIOD_MM:.0f} mm or less",
        arm="figure-1",
        measure=measures.get_total_error,
        unit="mm",
        asked=at_most(DISTANCE_PER_PERIOD_MM),
    ),
    Claim(
        figure="Fig. 1: trials in which a robot enters the disc",
        published="in none; one run",
        arm="figure-1",
        measure=measures.entered_obstacle,
        asked=rarely(),
    ),
    Claim(
        figure="Fig. 3: iteration in which criterion (20) is met, 100 particles",
        published="20",
        arm="figure-1",
        measure=measures.mean_iterations,
        asked=same_number(20),
        expected=Fate.MISSED,
        why=STOP_CRITERION_REASON,
    ),
    Claim(
        figure="Fig. 3: iteration in which criterion (20) is met, 1,000 particles",
        published="20",
        arm="swarm-1000",
        measure=measures.mean_iterations,
        asked=same_number(20),
        expected=Fate.MISSED,
        why=STOP_CRITERION_REASON,
    ),
    Claim(
        figure="Fig. 3: iteration in which criterion (20) is met, 10,000 particles",
        published="20",
        arm="swarm-10000",
        measure=measures.mean_iterations,
        asked=same_number(20),
        expected=Fate.MISSED,
        why=STOP_CRITERION_REASON,
    ),
    Claim(
        figure="Fig. 3: J falls exponentially; R^2 of a line through log J, minus R^2 of a line "
        "through J",
        published="no number is given; above 0",
        arm="first-search",
        measure=measures.exponential_fit_advantage,
        asked=at_least(0),
    ),
    Claim(
        figure="Fig. 3: J falls quickly at first; fraction of its fall in the first 10 of 100 "
        "iterations",
        published="no number is given; above 0.1",
        arm="first-search",
        measure=measures.early_decrease_fraction,
        asked=at_least(0.1),
    ),
    Claim(
        figure="Sections II to IV: the search finds nearly the smallest J, which is at least 0; "
        "J of step 0",
        published=f"no number is given; we read it as {DISTANCE_PER_PERIOD_MM:.0f} mm or less",
        arm="first-search",
        measure=measures.first_cost,
        unit="mm",
        asked=at_most(DISTANCE_PER_PERIOD_MM),
    ),
    Claim(
        figure="Section III: without errors, the sequence of step 0 is enough; its total error "
        "in open loop",
        published=f"no number is given; we read it as {DISTANCE_PER_PERIOD_MM:.0f} mm or less",
        arm="open-undisturbed",
        measure=measures.get_total_error,
        unit="mm",
        asked=at_most(DISTANCE_PER_PERIOD_MM),
    ),
    Claim(
        figure="Section III: with errors, it is not enough; total error on the bench, closed "
        "loop minus open loop",
        published="less; no number is given",
        arm="bench",
        minus="open-bench",
        measure=measures.get_total_error,
        unit="mm",
        asked=at_most(0),
    ),
    Claim(
        figure="Section IV-B: a warm start is a good guess; J of a step in the middle of a trial "
        "on the bench, minus J of 51 lengths searched without a warm start",
        published="no number is given; 0 or less",
        arm="bench",
        measure=measures.warm_start_cost_change,
        unit="mm",
        asked=at_most(0),
        expected=Fate.MISSED,
        why="three searches from a warm start need only 6 % of the evaluations, but find a "
        "higher J",
    ),
    Claim(
        figure="Section IV-B: the square of the first search ends at the starts; distance of a "
        "robot from its start",
        published=f"no number is given; we read it as {DISTANCE_PER_PERIOD_MM / 3:.0f} mm or less",
        arm="square",
        measure=measures.mean_displacement,
        unit="mm",
        asked=at_most(DISTANCE_PER_PERIOD_MM / 3),
    ),
]


EXPERIMENT_CLAIMS = [
    Claim(
        figure="mean total error of the 20 trials, on the bench",
        published=PUBLISHED_MEAN,
        arm="bench",
        measure=measures.get_total_error,
        unit="mm",
        asked=not_judged(mean_of),
        expected=Fate.NOT_JUDGED,
        why=UNKNOWN_LAB_REASON,
    ),
    Claim(
        figure="standard deviation of the total error of the 20 trials, on the bench",
        published=PUBLISHED_DEVIATION,
        arm="bench",
        measure=measures.get_total_error,
        unit="mm",
        asked=not_judged(deviation_of),
        expected=Fate.NOT_JUDGED,
        why=UNKNOWN_LAB_REASON,
    ),
    Claim(
        figure="Fig. 5: trials in which a robot enters the square, on the bench",
        published="in none; one run",
        arm="bench",
        measure=measures.entered_obstacle,
        asked=not_judged(share_of),
        expected=Fate.NOT_JUDGED,
        why=SAMPLED_PATH_REASON,
    ),
    Claim(
        figure="Fig. 5: trials in which a robot leaves the field of view of 1600 x 1800 mm, on "
        "the bench",
        published="not stated",
        arm="bench",
        measure=measures.left_arena,
        asked=not_judged(share_of),
        expected=Fate.NOT_JUDGED,
        why=NO_EDGE_COST_REASON,
    ),
]

CELL_CLAIMS = [
    Claim(
        figure="Section V: error of a cell, with three simulated cells",
        published="about 400 um",
        arm="cells",
        measure=measures.mean_robot_error,
        unit="um",
        asked=not_judged(mean_of),
        expected=Fate.NOT_JUDGED,
    ),
]

ENSEMBLE_CLAIMS = [
    Claim(
        figure=f"Section I: total error, {MINUS_ENSEMBLE}",
        published="less; no number is given",
        arm="bench",
        minus="ensemble",
        measure=measures.get_total_error,
        unit="mm",
        asked=at_most(0),
    ),
    Claim(
        figure=f"Section I: space, divided by the space of starts and targets, {MINUS_ENSEMBLE}",
        published="less; no number is given",
        arm="bench",
        minus="ensemble",
        measure=measures.relative_space,
        asked=at_most(0),
        expected=Fate.MISSED,
        why="with three robots, both methods need about the same space, or PSO-MPC a little more",
    ),
    Claim(
        figure='Section I: "we will not generate the rotating magnetic field"; trials in which '
        "it rotates",
        published="never",
        arm="bench",
        measure=measures.rotation_duration_s,
        asked=rarely(),
        expected=Fate.MISSED,
        why="nothing in the cost (7) keeps the direction from turning through a whole turn",
    ),
    Claim(
        figure=f"Section I: time for which the field rotates, {MINUS_ENSEMBLE}",
        published="less; no number is given",
        arm="bench",
        minus="ensemble",
        measure=measures.rotation_duration_s,
        unit="s",
        asked=at_most(0),
    ),
]

PAPER = Paper(
    source="Ou, Kang, Kim and Julius, the paper of PSO-MPC (simulation)",
    arms=ARMS,
    claims=[*SIMULATION_CLAIMS, *EXPERIMENT_CLAIMS, *CELL_CLAIMS, *ENSEMBLE_CLAIMS],
)
