"""Whether wheels that lag explain the turns of robots as well as wheels that do not.

A robot whose wheels follow with a time constant T turns by the mean of what directions ask of it,
which weighs the past as exp(-t / T):

    T q' + q = a sin(u(t - dead_time) + f - h),    h' = q,

with heading h, direction u and heading bias f. The turns between poses are linear in a cos f and
a sin f, and are fitted for T = 0 and for T = LAG_S, each with its likeliest dead time: that of
lagging wheels is shorter by about T. Half of the poses give the turns, those between them the
headings of the sine: noise that both had would look like a lag.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats
from tetractl.replay.identification.motion_angle import Complex, robust_gains
from tetractl.replay.identification.tracks import SETTLED_S, Track, rows_apart

LAG_S = 0.02
"""Lag of the wheels that is tried [s]. A host that foresees their lag makes robots turn as if a
longer one were about so long."""
NEAR_S = 0.05
APART_S = 0.0025
"""How far from the expected one dead times are tried, and how far apart [s]."""
GRID_S = 0.01
"""Time step of the integrals [s]."""
TURN_S = 0.05
"""Least duration of a turn that is evaluated [s]."""
GAP_S = 0.3
"""Time without a pose after which turns are not evaluated [s]."""
BLOCK = 20
"""Number of turns, 1 s or more, of the blocks whose differences say how sure a sum is."""
SURE = 1.65
"""Standard deviations by which turns without a lag must fit better: 95 %, one-sided."""


def lag_may_turn(tracks: Sequence[Track], dead_time_s: float) -> bool:
    """Return whether wheels that lag by LAG_S explain the turns of robots as well as wheels that do
    not, which have about some dead time [s]: what these leave unexplained is not surely less.
    """
    robots = [
        [_Turns.of(track, robot) for track in tracks] for robot in range(len(tracks[0].names))
    ]
    if not all(any(len(turns.angle) for turns in of_robot) for of_robot in robots):
        return True
    without = _unexplained(robots, 0.0, dead_time_s)
    with_lag = _unexplained(robots, LAG_S, dead_time_s - LAG_S)
    of_blocks = np.add.reduceat(with_lag - without, np.arange(0, len(without), BLOCK))
    deviation = of_blocks.std() * np.sqrt(len(of_blocks))
    return bool(of_blocks.sum() < SURE * deviation)


@dataclass(frozen=True, slots=True)
class _Turns:
    """The turns of a robot in a track: from `begin` to `end` (K,) [s] by `angle` (K,) [rad].
    Between them it has `heading` (G + 1,) [rad] at `grid` (G + 1,) [s], and `u` (C,) was sent
    `when` (C,) [s].
    """

    begin: Floats
    end: Floats
    angle: Floats
    grid: Floats
    heading: Floats
    when: Floats
    u: Floats

    @classmethod
    def of(cls, track: Track, robot: int) -> "_Turns":
        """Return the turns of a robot from where it drives until the stop."""
        times = track.exposed[:, robot]
        drives = (times >= track.sent[0] + SETTLED_S) & (times <= track.until)
        is_used = drives & track.valid[:, robot]
        times = times[is_used]
        headings = np.unwrap(track.poses[is_used, robot, 2])
        rows = rows_apart(times[::2], TURN_S)
        ends = times[::2][rows]
        turned = np.diff(headings[::2][rows])
        is_seen = np.diff(ends) < GAP_S
        grid = np.arange(ends[0], ends[-1] + GRID_S, GRID_S) if len(ends) else np.zeros(1)
        return cls(
            begin=ends[:-1][is_seen],
            end=ends[1:][is_seen],
            angle=turned[is_seen],
            grid=grid,
            heading=np.interp(grid, times[1::2], headings[1::2]) if len(rows) > 1 else grid,
            when=track.sent,
            u=track.u,
        )

    def asked(self, lag_s: float, dead_time_s: float) -> Complex:
        """Return the integrals of exp(i (u - h)) over the turns (K,), after a lag and dead time."""
        middle = 0.5 * (self.heading[:-1] + self.heading[1:])
        pull = np.diff(self._sent_until(self.grid - dead_time_s)) * np.exp(-1j * middle)
        if lag_s > 0:  # wheels follow the pull, which is even within a step of the grid
            from scipy.signal import lfilter  # slow to import, and only needed here

            decay = np.exp(-GRID_S / lag_s)
            share = (1 - decay) / 2
            pull = lfilter([share, share], [1, -decay], pull)
        pulled = np.concatenate([[0], np.cumsum(pull)])
        until_end = np.interp(self.end, self.grid, pulled)
        until_begin = np.interp(self.begin, self.grid, pulled)
        return np.asarray(until_end - until_begin, dtype=np.complex128)

    def _sent_until(self, times: Floats) -> Complex:
        """Return the integrals of exp(i u) over what was sent until some times (G + 1,) [s].

        Each direction counts until the next one, the first one before its time, too.
        """
        sent = np.exp(1j * self.u)
        until_sent = np.concatenate([[0], np.cumsum(np.diff(self.when) * sent[:-1])])
        newest = np.maximum(np.searchsorted(self.when, times, side="right") - 1, 0)
        until_times = until_sent[newest] + (times - self.when[newest]) * sent[newest]
        return np.asarray(until_times, dtype=np.complex128)


def _unexplained(robots: Sequence[Sequence[_Turns]], lag_s: float, near_s: float) -> Floats:
    """Return how far the turns of robots (R, K) are from those of wheels with a lag [rad], one
    robot after another, at the dead time near `near_s` [s] that explains most."""

    def rests(dead_time_s: float) -> Floats:
        of_robots: list[Floats] = []
        for of_robot in robots:
            angle = np.concatenate([turns.angle for turns in of_robot])
            turning = np.concatenate([turns.asked(lag_s, dead_time_s) for turns in of_robot])
            causes = np.column_stack([turning.imag, turning.real])
            of_robots.append(np.abs(angle - causes @ robust_gains(angle, causes)))
        return np.concatenate(of_robots)

    dead_times_s = np.arange(near_s - NEAR_S, near_s + NEAR_S, APART_S)
    return min((rests(dead_time_s) for dead_time_s in dead_times_s.tolist()), key=np.sum)
