"""Measured turns of robots between poses, and the turns that the directions ask for.

Every second pose is used to measure the turns, and the poses between them give the headings for the
sine. If both used the same poses, their common noise would look like a lag.
"""

from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats
from tetractl_identify.pose_steps import Complex
from tetractl_identify.tracks import SETTLING_S, Track, select_rows_apart

GRID_STEP_S = 0.01
"""Time step of the integrals [s]."""
TURN_MIN_S = 0.05
"""Minimum duration of a turn [s]."""
GAP_MIN_S = 0.3
GAP_RATIO_MAX = 2.2
"""Duration from which a turn is left out, relative to the median time between two poses.

The turn must also last GAP_MIN_S [s] or more. The robot was then not seen.
"""


@dataclass(frozen=True, slots=True)
class TurnSamples:
    """The turns of a robot in a track.

    Attributes:
        begin_s: Begin of each turn, shape (K,) [s].
        end_s: End of each turn, shape (K,) [s].
        turn_rad: Angle of each turn, shape (K,) [rad].
        grid_s: Evenly spaced times from the first turn to the last, shape (G + 1,) [s].
        grid_heading_rad: Headings at the times `grid_s`, shape (G + 1,) [rad].
        sent_s: Times at which the directions that the robot received were sent, shape (C,) [s].
        direction_rad: The directions that were sent at the times `sent_s`, shape (C,) [rad].
    """

    begin_s: Floats
    end_s: Floats
    turn_rad: Floats
    grid_s: Floats
    grid_heading_rad: Floats
    sent_s: Floats
    direction_rad: Floats

    @classmethod
    def from_track(cls, track: Track, robot: int) -> "TurnSamples":
        """Find the turns of a robot between the start of its motion and the stop.

        Turns while the robot received nothing for too long are left out.
        """
        times_s = track.exposed_s[:, robot]
        is_received = track.received_by(robot)
        drives = (times_s >= track.sent_s[0] + SETTLING_S) & (times_s <= track.stop_s)
        is_used = drives & track.follows_commands[:, robot]
        times_s = times_s[is_used]
        headings = np.unwrap(track.poses[is_used, robot, 2])
        turn_rows = select_rows_apart(times_s[::2], TURN_MIN_S)
        turn_ends_s = times_s[::2][turn_rows]
        turn_rad = np.diff(headings[::2][turn_rows])
        is_seen = (
            np.diff(turn_ends_s)
            < max(GAP_MIN_S, GAP_RATIO_MAX * float(np.median(np.diff(times_s[::2]))))
            if len(turn_ends_s) > 1
            else np.zeros(0, dtype=np.bool_)
        )
        grid_s = (
            np.arange(turn_ends_s[0], turn_ends_s[-1] + GRID_STEP_S, GRID_STEP_S)
            if len(turn_ends_s)
            else np.zeros(1)
        )
        return cls(
            begin_s=turn_ends_s[:-1][is_seen],
            end_s=turn_ends_s[1:][is_seen],
            turn_rad=turn_rad[is_seen],
            grid_s=grid_s,
            grid_heading_rad=np.interp(grid_s, times_s[1::2], headings[1::2])
            if len(turn_rows) > 1
            else grid_s,
            sent_s=track.sent_s[is_received],
            direction_rad=track.direction_rad[is_received],
        )

    def integrate_pull(self, lag_s: float, dead_time_s: float) -> Complex:
        """Integrate exp(i (u - h)), the pull of the directions, over each turn, shape (K,).

        u is the direction that acts, and h is the robot's heading. The robot turns at the rate
        a sin(u - h), so a times the imaginary part of the result is the turn that was asked for.

        Args:
            lag_s: Time constant with which the wheels follow [s].
            dead_time_s: Time from the sending of a direction until it acts [s].
        """
        if not len(self.sent_s):
            return np.zeros(len(self.turn_rad), dtype=np.complex128)
        mean_heading_rad = 0.5 * (self.grid_heading_rad[:-1] + self.grid_heading_rad[1:])
        pull = np.diff(self._integrate_directions(self.grid_s - dead_time_s)) * np.exp(
            -1j * mean_heading_rad
        )
        if lag_s > 0:  # wheels follow the pull, which is even within a step of the grid
            from scipy.signal import lfilter  # slow to import, and only needed here

            decay = np.exp(-GRID_STEP_S / lag_s)
            step_gain = (1 - decay) / 2
            pull = lfilter([step_gain, step_gain], [1, -decay], pull)
        pull_integral = np.concatenate([[0], np.cumsum(pull)])
        integral_at_end = np.interp(self.end_s, self.grid_s, pull_integral)
        integral_at_begin = np.interp(self.begin_s, self.grid_s, pull_integral)
        return np.asarray(integral_at_end - integral_at_begin, dtype=np.complex128)

    def _integrate_directions(self, times_s: Floats) -> Complex:
        """Integrate exp(i u) over the sent directions up to the times (G + 1,) [s].

        Each direction counts until the next one. The first direction also counts before its own
        time.
        """
        direction_phasor = np.exp(1j * self.direction_rad)
        integral_at_sending = np.concatenate(
            [[0], np.cumsum(np.diff(self.sent_s) * direction_phasor[:-1])]
        )
        newest = np.maximum(np.searchsorted(self.sent_s, times_s, side="right") - 1, 0)
        integral_at_times = (
            integral_at_sending[newest] + (times_s - self.sent_s[newest]) * direction_phasor[newest]
        )
        return np.asarray(integral_at_times, dtype=np.complex128)
