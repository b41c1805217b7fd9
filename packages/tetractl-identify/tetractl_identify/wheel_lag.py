"""Checks whether lagging wheels explain the turns of robots as well as wheels without a lag.

The wheels of a robot may follow with a time constant T. The robot then turns at a weighted mean of
the rates that the past directions ask for, with weights exp(-t / T):

    T q' + q = a sin(u(t - dead_time) + f - h),    h' = q,

with heading h, turning rate q, direction u and heading bias f. The turns between poses are linear
in a cos f and a sin f. They are fitted for T = 0 and for T = LAG_S, each with its most likely dead
time, which is shorter by about T for lagging wheels.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.core.poses import Floats
from tetractl_identify.pose_steps import robust_gains
from tetractl_identify.tracks import Track
from tetractl_identify.turn_samples import TurnSamples

LAG_S = 0.02
"""Lag of the wheels that is tried [s].

A host that predicts their lag makes robots turn as if a longer lag were about this long.
"""
NEAR_S = 0.05
APART_S = 0.0025
"""Spacing of the dead times that are tried [s].

NEAR_S is their maximum distance from the expected one.
"""
BLOCK = 20
"""Number of turns in a block, 1 s or more.

The differences between blocks show how certain a sum over them is.
"""
SURE = 1.65
"""Number of standard deviations by which turns without a lag must fit better: 95 %, one-sided."""


def lag_may_turn(tracks: Sequence[Track], dead_time_s: float) -> bool:
    """Check whether wheels that lag by LAG_S explain the turns as well as wheels without a lag.

    The result is False only if lagging wheels clearly leave more of the turns unexplained. In both
    cases, commands also have a dead time near the given one.

    Args:
        tracks: Tracks of the same robots.
        dead_time_s: The dead time [s].
    """
    robots = [
        [TurnSamples.from_track(track, robot) for track in tracks]
        for robot in range(len(tracks[0].names))
    ]
    if not all(any(len(turns.angle) for turns in of_robot) for of_robot in robots):
        return True
    without = _unexplained(robots, 0.0, dead_time_s)
    with_lag = _unexplained(robots, LAG_S, dead_time_s - LAG_S)
    of_blocks = np.add.reduceat(with_lag - without, np.arange(0, len(without), BLOCK))
    deviation = of_blocks.std() * np.sqrt(len(of_blocks))
    return bool(of_blocks.sum() < SURE * deviation)


def _unexplained(robots: Sequence[Sequence[TurnSamples]], lag_s: float, near_s: float) -> Floats:
    """Compute how far the turns of robots (R, K) differ from those with lagging wheels [rad].

    The turns of all robots are concatenated. Of the dead times near `near_s` [s], the best one is
    used.
    """

    def rests(dead_time_s: float) -> Floats:
        of_robots: list[Floats] = []
        for of_robot in robots:
            angle = np.concatenate([turns.angle for turns in of_robot])
            turning = np.concatenate([turns.asked_turns(lag_s, dead_time_s) for turns in of_robot])
            causes = np.column_stack([turning.imag, turning.real])
            of_robots.append(np.abs(angle - causes @ robust_gains(angle, causes)))
        return np.concatenate(of_robots)

    dead_times_s = np.arange(near_s - NEAR_S, near_s + NEAR_S, APART_S)
    return min((rests(dead_time_s) for dead_time_s in dead_times_s.tolist()), key=np.sum)
