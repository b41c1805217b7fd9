"""Checks whether lagging wheels explain the turns of robots as well as wheels without a lag.

The wheels of a robot may follow with a time constant T. The robot then turns at a weighted mean of
the rates that the past directions ask for, with weights exp(-t / T):

    T q' + q = a sin(u(t - dead_time) + f - h),    h' = q,

with heading h, turning rate q, direction u and heading bias f. The turns between poses are linear
in a cos f and a sin f. They are fitted for T = 0 and for
T = TRIED_LAG_S, each with its most likely dead time, which is shorter by about T for lagging
wheels.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.core.poses import Floats
from tetractl_identify.pose_steps import fit_robust_gains
from tetractl_identify.tracks import Track
from tetractl_identify.turn_samples import TurnSamples

TRIED_LAG_S = 0.02
"""Lag of the wheels that is tried [s].

A host that predicts their lag makes robots turn as if a longer lag were about this long.
"""
DEAD_TIME_REACH_S = 0.05
"""Maximum difference of a tried dead time from the expected dead time [s]."""
DEAD_TIME_SPACING_S = 0.0025
"""Spacing of the dead times that are tried [s]."""
TURNS_PER_BLOCK = 20
"""Number of turns in a block, 1 s or more.

The differences between blocks show how certain a sum over them is.
"""
CERTAINTY_STDS = 1.65
"""Number of standard deviations by which turns without a lag must fit better: 95 %, one-sided."""


def may_lag_explain_turns(tracks: Sequence[Track], dead_time_s: float) -> bool:
    """Check whether lagging wheels explain the turns as well as wheels without a lag.

    The lag is TRIED_LAG_S. The result is False only if lagging wheels clearly leave more of the
    turns unexplained. In both cases, commands also have a dead time near the given one.

    Args:
        tracks: Tracks of the same robots.
        dead_time_s: The dead time [s].
    """
    turns_by_robot = [
        [TurnSamples.from_track(track, robot) for track in tracks]
        for robot in range(len(tracks[0].names))
    ]
    if not all(any(len(turns.turn_rad) for turns in of_robot) for of_robot in turns_by_robot):
        return True
    residuals_without_lag = _compute_turn_residuals(turns_by_robot, 0.0, dead_time_s)
    residuals_with_lag = _compute_turn_residuals(
        turns_by_robot, TRIED_LAG_S, dead_time_s - TRIED_LAG_S
    )
    excess_by_block = np.add.reduceat(
        residuals_with_lag - residuals_without_lag,
        np.arange(0, len(residuals_without_lag), TURNS_PER_BLOCK),
    )
    std_of_sum = excess_by_block.std() * np.sqrt(len(excess_by_block))
    return bool(excess_by_block.sum() < CERTAINTY_STDS * std_of_sum)


def _compute_turn_residuals(
    turns_by_robot: Sequence[Sequence[TurnSamples]], lag_s: float, expected_dead_time_s: float
) -> Floats:
    """Compute the residuals of all robots' turns after a fit with a lag of the wheels [rad].

    The residuals of all robots are concatenated. Of the dead times near `expected_dead_time_s`, the
    best one is used.
    """

    def compute_residuals(dead_time_s: float) -> Floats:
        residuals: list[Floats] = []
        for robot_turns in turns_by_robot:
            angles = np.concatenate([turns.turn_rad for turns in robot_turns])
            asked_turns = np.concatenate(
                [turns.integrate_pull(lag_s, dead_time_s) for turns in robot_turns]
            )
            causes = np.column_stack([asked_turns.imag, asked_turns.real])
            residuals.append(np.abs(angles - causes @ fit_robust_gains(angles, causes)))
        return np.concatenate(residuals)

    dead_times_s = np.arange(
        expected_dead_time_s - DEAD_TIME_REACH_S,
        expected_dead_time_s + DEAD_TIME_REACH_S,
        DEAD_TIME_SPACING_S,
    )
    return min(
        (compute_residuals(dead_time_s) for dead_time_s in dead_times_s.tolist()), key=np.sum
    )
