"""Measured turns of robots between poses, and the turns that the directions ask for.

Every second pose is used to measure the turns, and the poses between them give the headings for the
sine. If both used the same poses, their common noise would look like a lag.
"""

from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats
from tetractl_identify.pose_steps import Complex
from tetractl_identify.tracks import SETTLED_S, Track, rows_apart

GRID_S = 0.01
"""Time step of the integrals [s]."""
TURN_S = 0.05
"""Minimum duration of a turn [s]."""
GAP_MIN_S = 0.3
GAP_RATIO_MAX = 2.2
"""Multiple of the median time between two poses from which a turn is left out.

It must also last GAP_S [s] or more: then the robot was not seen.
"""


@dataclass(frozen=True, slots=True)
class TurnSamples:
    """The turns of a robot in a track.

    Attributes:
        begin_s: Begin of each turn, shape (K,) [s].
        end_s: End of each turn, shape (K,) [s].
        angle: Angle of each turn, shape (K,) [rad].
        grid: Times from the first turn to the last, shape (G + 1,) [s].
        heading: Headings at these times, shape (G + 1,) [rad].
        sent_s: Times at which the directions that the robot received were sent, shape (C,) [s].
        u: These directions, shape (C,) [rad].
    """

    begin_s: Floats
    end_s: Floats
    angle: Floats
    grid: Floats
    heading: Floats
    sent_s: Floats
    u: Floats

    @classmethod
    def from_track(cls, track: Track, robot: int) -> "TurnSamples":
        """Find the turns of a robot from where it drives until the stop.

        Turns while the robot received nothing for too long are left out.
        """
        times = track.exposed[:, robot]
        received = track.received_by(robot)
        drives = (times >= track.sent[0] + SETTLED_S) & (times <= track.until)
        is_used = drives & track.commanded[:, robot]
        times = times[is_used]
        headings = np.unwrap(track.poses[is_used, robot, 2])
        kept_rows = rows_apart(times[::2], TURN_S)
        turn_ends = times[::2][kept_rows]
        turned = np.diff(headings[::2][kept_rows])
        is_seen = (
            np.diff(turn_ends)
            < max(GAP_MIN_S, GAP_RATIO_MAX * float(np.median(np.diff(times[::2]))))
            if len(turn_ends) > 1
            else np.zeros(0, dtype=np.bool_)
        )
        grid = (
            np.arange(turn_ends[0], turn_ends[-1] + GRID_S, GRID_S)
            if len(turn_ends)
            else np.zeros(1)
        )
        return cls(
            begin_s=turn_ends[:-1][is_seen],
            end_s=turn_ends[1:][is_seen],
            angle=turned[is_seen],
            grid=grid,
            heading=np.interp(grid, times[1::2], headings[1::2]) if len(kept_rows) > 1 else grid,
            sent_s=track.sent[received],
            u=track.u[received],
        )

    def asked_turns(self, lag_s: float, dead_time_s: float) -> Complex:
        """Integrate exp(i (u - h)) over the turns (K,), for a given lag and dead time.

        u is the direction, and h the robot's heading.
        """
        if not len(self.sent_s):
            return np.zeros(len(self.angle), dtype=np.complex128)
        middle = 0.5 * (self.heading[:-1] + self.heading[1:])
        asked_rate = np.diff(self._sent_until(self.grid - dead_time_s)) * np.exp(-1j * middle)
        if lag_s > 0:  # wheels follow the pull, which is even within a step of the grid
            from scipy.signal import lfilter  # slow to import, and only needed here

            decay = np.exp(-GRID_S / lag_s)
            step_gain = (1 - decay) / 2
            asked_rate = lfilter([step_gain, step_gain], [1, -decay], asked_rate)
        asked_angle = np.concatenate([[0], np.cumsum(asked_rate)])
        until_end = np.interp(self.end_s, self.grid, asked_angle)
        until_begin = np.interp(self.begin_s, self.grid, asked_angle)
        return np.asarray(until_end - until_begin, dtype=np.complex128)

    def _sent_until(self, times: Floats) -> Complex:
        """Integrate exp(i u) over the sent directions up to the times (G + 1,) [s].

        Each direction counts until the next one. The first direction also counts before its own
        time.
        """
        sent = np.exp(1j * self.u)
        until_sent = np.concatenate([[0], np.cumsum(np.diff(self.sent_s) * sent[:-1])])
        newest = np.maximum(np.searchsorted(self.sent_s, times, side="right") - 1, 0)
        until_times = until_sent[newest] + (times - self.sent_s[newest]) * sent[newest]
        return np.asarray(until_times, dtype=np.complex128)
