"""Chooses the steps of a robot that are used to fit its response to commands.

A step is the motion from one pose to a later one, and lasts at least STEP_S. Two kinds of steps are
left out: steps during which no command acts, because the robot then stands still, and steps whose
residual is more than OUTLIER_FACTOR times the usual one. Such outliers occur, for example, if a
tracker confuses two bodies. The clocks of poses and commands may differ. `_find_delay` therefore
finds the delay after which the commands explain most of the motion.

Shapes: a robot has S steps in all its tracks, of which the fit uses M. One track has C commands.
Pairs of integrals of a motion stand in columns: first of the speed, then of the turning rate.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_banded
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Bools, Floats, Integers
from tetractl_identify.fit import assign_blocks
from tetractl_identify.heading_offset import DrivenSteps
from tetractl_identify.identify import INTERVALS_MIN
from tetractl_identify.pose_steps import STD_OF_MEDIAN, Complex, PoseSteps, fit_robust_gains
from tetractl_identify.tracks import Track, integrate_held_rates, select_rows_apart

STEP_S = 0.1
"""Minimum duration of a step [s]."""
DURATION_LIMIT_MIN_S = 0.55
DURATION_RATIO_MAX = 2.2
"""Duration from which a step is left out, relative to the median time between two poses.

The step must also last DURATION_LIMIT_MIN_S [s] or more. The robot was then not seen.
"""
OUTLIER_FACTOR = 8.0
"""Distance from the expected motion above which a step is left out [standard deviations]."""
NEIGHBOURS_CHECKED = 5
"""Number of steps by which commands may act earlier or later than they seem to at first."""
DELAY_OFFSETS_S = np.arange(-200, 201) / 20
"""Delays that are tried, minus the expected one [s]."""
PEAK_HALF_WIDTH = 5
"""Number of neighbours on either side that a delay must exceed to count as a peak."""
EXPLAINED_TOLERANCE = 0.1
"""Fraction of the motion by which a delay nearer to the expected one may explain less."""
REVERSED_TURN_FACTOR = 0.8
"""Fraction of the motion for which a delay counts if robots turn right where they are sent left."""
CLIPPED_QUANTILE = 0.02
"""Fraction of the rates that is clipped at either end."""
ASSUMED_LAG_S = 0.1
"""Lag of both motions that is assumed while steps are chosen [s]."""
DEAD_TIME_UNIT_S = 0.05
"""Usual change of a dead time [s]."""
INTEGRALS_CACHED = 64
"""Number of integrals that are not computed again: most parameters do not change them."""
PROPORTIONAL_CORRELATION = 0.999
"""Squared correlation of the two integrals above which the data cannot tell them apart.

This happens on circles. The motion is then attributed to the robot's own command.
"""


@dataclass(frozen=True, slots=True)
class DrivenTrack:
    """The poses and commands of one robot in one track.

    Attributes:
        pose_s: Times of its poses [s], shape (S + 1,).
        steps: The steps between its poses.
        sent_s: Times of the commands [s], shape (C,).
        commands: Speeds v and turning rates w that were sent, shape (C, 2).
        two_clocks: Whether poses and commands may have different clocks, as in `Track`.
    """

    pose_s: Floats
    steps: PoseSteps
    sent_s: Floats
    commands: Floats
    two_clocks: bool

    @property
    def duration_s(self) -> float:
        """Time from the first pose to the last [s]. It is 0 without poses."""
        return float(self.pose_s[-1] - self.pose_s[0]) if len(self.pose_s) else 0.0

    def integrals(self, dead_time: float, lag: float, drift: float = 0.0) -> Floats:
        """Integrate the lagging rates r over each step, shape (S, 2).

        The rates follow the commands u with a lag: lag dr/dt = u - r. The integral of r therefore
        is the integral of u minus lag times the increase of r. With U, the integral of u, it is the
        difference of U(t) - lag r(t) between the two ends of a step. Between two commands, r
        approaches u as exp(-t / lag). Before the first command, robots have the rates of this
        command.

        Args:
            dead_time: Time from the sending of a command until it acts [s].
            lag: Time constant with which the rates follow the commands [s].
            drift: How fast the clock of the commands gains on the clock of the poses [s/s].
        """
        if len(self.pose_s) < 2 or not len(self.sent_s):
            return np.zeros((len(self.steps.turn_rad), 2))
        gaps_s = np.diff(self.sent_s)
        decay = np.exp(-gaps_s / lag)
        # r at each command: r[k + 1] = decay[k] r[k] + (1 - decay[k]) u[k], a system in two bands
        system_bands = np.ones((2, len(self.commands)))
        system_bands[1, :-1] = -decay
        system_bands[1, -1] = 0.0
        first_command = self.commands[:1]
        driven_terms = (1 - decay)[:, None] * self.commands[:-1]
        rates = solve_banded((1, 0), system_bands, np.vstack([first_command, driven_terms]))
        command_integrals = np.cumsum(gaps_s[:, None] * self.commands[:-1], axis=0)
        integrals_at_commands = np.vstack([np.zeros((1, 2)), command_integrals])

        middle_s = (self.pose_s[0] + self.pose_s[-1]) / 2
        acting_s = self.pose_s - dead_time + drift * (self.pose_s - middle_s)
        newest_command = np.maximum(np.searchsorted(self.sent_s, acting_s, side="right") - 1, 0)
        command = self.commands[newest_command]
        command_age_s = (acting_s - self.sent_s[newest_command])[:, None]
        rate = command + (rates[newest_command] - command) * np.exp(
            -np.maximum(command_age_s, 0.0) / lag
        )
        return np.diff(
            integrals_at_commands[newest_command] + command_age_s * command - lag * rate, axis=0
        )

    def sent(self, delay: float) -> Floats:
        """Compute the commanded distance and turn in each step, shape (S, 2).

        Commands act a delay [s] after they were sent. All values are 0 if nothing was
        sent.
        """
        if not len(self.sent_s):
            return np.zeros((len(self.steps.turn_rad), 2))
        integrals_at_poses = integrate_held_rates(self.sent_s, self.commands, self.pose_s - delay)
        return np.diff(integrals_at_poses, axis=0)

    def acts(self, dead_time: float) -> Bools:
        """Find the steps during which some command acts, shape (S,).

        These steps lie between the times at which the first and the last command take effect.
        Commands take effect `dead_time` [s] after they are sent.
        """
        if not len(self.sent_s):
            return np.zeros(len(self.steps.turn_rad), dtype=np.bool_)
        acting_s = self.pose_s - dead_time
        return (acting_s[:-1] >= self.sent_s[0]) & (acting_s[1:] <= self.sent_s[-1])


def select_driven_track(track: Track, robot: int) -> DrivenTrack:
    """Select the steps and the commands of one robot in a track.

    Steps lead between poses at least STEP_S apart at which the robot drives as commanded.
    Commands with a NaN are left out.
    """
    times_s = track.exposed_s[:, robot]
    frame_rows = np.flatnonzero(track.follows_commands[:, robot])
    frame_rows = frame_rows[select_rows_apart(times_s[frame_rows], STEP_S)]
    has_command = np.isfinite(track.twists[:, robot]).all(axis=1)
    return DrivenTrack(
        pose_s=times_s[frame_rows],
        steps=PoseSteps.from_poses(times_s[frame_rows], track.poses[frame_rows, robot]),
        sent_s=track.sent_s[has_command],
        commands=track.twists[has_command, robot],
        two_clocks=track.has_two_clocks,
    )


@dataclass(frozen=True, slots=True, eq=False)
class UsedSteps:
    """The M steps of a robot that the fit uses.

    Attributes:
        tracks: All tracks of the robot.
        rows: Indices of the used steps among the steps of all tracks, shape (M,).
        turned: Turn in each step, shape (M,) [rad].
        moved: Distances along and across the heading, shape (M,), as in `PoseSteps`.
        begin_s: Begin of each step, shape (M,) [s].
        duration_s: Duration of each step, shape (M,) [s].
        block: Index of the block of time that contains each step, shape (M,).
        neighbours: Whether the next step begins with the pose at which a step ends, shape (M - 1,).
        left_out: Number of steps left out because they are too far off.
        dead_time: Dead time at which the search starts [s].
        drift_unit: Typical drift between the clocks, used as the unit of the search. 0 for one
            clock.
        in_one_ratio: Whether speed and turning rate were always sent in the same ratio.
    """

    tracks: list[DrivenTrack]
    rows: Integers
    turned: Floats
    moved: Complex
    begin_s: Floats
    duration_s: Floats
    block: Integers
    neighbours: Bools
    left_out: int
    dead_time: float
    drift_unit: float
    in_one_ratio: bool

    @property
    def distance_along(self) -> Floats:
        """Distance travelled along the heading in each step, shape (M,) [length unit].

        It is negative for a step backwards.
        """
        return self.moved.real

    @property
    def speed(self) -> float:
        """The median of the robot's speed over the steps [length unit/s]. It is never 0."""
        return max(float(np.median(np.abs(self.distance_along) / self.duration_s)), 1e-12)

    def driven(self, integrals: Floats) -> DrivenSteps:
        """Combine the steps with the distances and turns commanded in them, shape (M, 2)."""
        return DrivenSteps(
            displacement=self.moved,
            duration_s=self.duration_s,
            distance_sent=integrals[:, 0],
            turn_sent=integrals[:, 1],
            block=self.block,
        )

    def integrals(
        self, dead_time: float, speed_lag: float, turning_lag: float, drift: float = 0.0
    ) -> Floats:
        """Integrate the commanded speed and turning rate over each step.

        Args:
            dead_time: Time from the sending of a command until it acts [s].
            speed_lag: Time constant with which the speed follows [s].
            turning_lag: Time constant with which the turning rate follows [s].
            drift: How fast the clock of the commands gains on the clock of the poses [s/s].

        Returns:
            The integrals, shape (M, 2): of the speed [length unit] and of the turning rate [rad].
        """
        speed_integrals = self._with_lag(dead_time, speed_lag, drift)
        turning_integrals = self._with_lag(dead_time, turning_lag, drift)
        return np.column_stack([speed_integrals[:, 0], turning_integrals[:, 1]])

    @lru_cache(INTEGRALS_CACHED)  # noqa: B019 few are kept
    def _with_lag(self, dead_time: float, lag: float, drift: float) -> Floats:
        """Integrate both rates over each step with the same lag [s], shape (M, 2).

        `dead_time` and `drift` have the meaning that they have in `integrate_over_tracks`.
        """
        return integrate_over_tracks(self.tracks, dead_time, lag, drift)[self.rows]


def integrate_over_tracks(
    tracks: Sequence[DrivenTrack], dead_time: float, lag: float, drift: float = 0.0
) -> Floats:
    """Integrate the commanded speed and turning rate over all steps of some tracks, shape (S, 2).

    Args:
        tracks: The tracks.
        dead_time: Time from the sending of a command until it acts [s].
        lag: Time constant with which the rates follow the commands [s].
        drift: How fast the clock of the commands gains on the clock of the poses [s/s].
    """
    return np.concatenate([track.integrals(dead_time, lag, drift) for track in tracks])


def choose_steps(name: str, tracks: list[DrivenTrack], expected_s: float) -> UsedSteps:
    """Choose the steps of a robot to use.

    Args:
        name: The robot.
        tracks: Its tracks.
        expected_s: The expected dead time [s].

    Raises:
        UsageError: If it drives in too few steps.
    """
    steps = PoseSteps.concatenate([track.steps for track in tracks])
    is_driving = steps.duration_s < _duration_limit(steps)
    _require_enough(name, is_driving)
    dead_time = _find_delay(tracks, steps, expected_s + ASSUMED_LAG_S) - ASSUMED_LAG_S
    command_integrals = integrate_over_tracks(tracks, dead_time, ASSUMED_LAG_S)
    is_commanded = np.concatenate([track.acts(dead_time) for track in tracks])
    is_driving &= is_commanded & (np.hypot(command_integrals[:, 0], command_integrals[:, 1]) > 1e-9)
    _require_enough(name, is_driving)
    distance_along = steps.displacement.real
    turn_rad = steps.turn_rad
    is_far_off = _far_off(turn_rad, command_integrals, is_driving) | _far_off(
        distance_along, command_integrals, is_driving
    )
    rows = np.flatnonzero(is_driving & ~is_far_off)
    track_ends = np.cumsum([len(track.steps.turn_rad) for track in tracks])[:-1]
    begin_s = np.concatenate([track.pose_s[:-1] for track in tracks])
    longest_track_s = max(track.duration_s for track in tracks)
    has_two_clocks = any(track.two_clocks for track in tracks)
    return UsedSteps(
        tracks=tracks,
        rows=rows,
        turned=turn_rad[rows],
        moved=steps.displacement[rows],
        begin_s=begin_s[rows],
        duration_s=steps.duration_s[rows],
        block=assign_blocks(steps.duration_s)[rows],
        neighbours=(np.diff(rows) == 1) & ~np.isin(rows[1:], track_ends),
        left_out=int((is_driving & is_far_off).sum()),
        dead_time=dead_time,
        # the ends of the longest recording are off by the usual change of the dead time
        drift_unit=2 * DEAD_TIME_UNIT_S / longest_track_s if has_two_clocks else 0.0,
        in_one_ratio=_are_in_one_ratio(command_integrals[rows]),
    )


def _are_in_one_ratio(command_integrals: Floats) -> bool:
    """Check whether two integrals (M, 2) are nearly proportional to each other.

    The result is False if one of them is 0 throughout.
    """
    lengths = np.linalg.norm(command_integrals, axis=0)
    product = float(command_integrals[:, 0] @ command_integrals[:, 1])
    return (
        bool(lengths.all()) and product**2 > PROPORTIONAL_CORRELATION * float(np.prod(lengths)) ** 2
    )


def _duration_limit(steps: PoseSteps) -> float:
    """Compute the duration above which a step is left out [s].

    It is DURATION_RATIO_MAX times the median, and at least DURATION_LIMIT_MIN_S, also if there are
    no steps.
    """
    if not len(steps.duration_s):
        return DURATION_LIMIT_MIN_S
    return max(DURATION_LIMIT_MIN_S, DURATION_RATIO_MAX * float(np.median(steps.duration_s)))


def _require_enough(name: str, is_driving: Bools) -> None:
    """Check that a robot drives in at least INTERVALS_MIN steps (S,).

    Raises:
        UsageError: If it drives in fewer.
    """
    if is_driving.sum() < INTERVALS_MIN:
        raise UsageError(
            f"robot {printable(name)} drives in only {is_driving.sum()} of the steps between "
            "its poses",
            f"at least {INTERVALS_MIN} steps are needed: give longer recordings, or remove the "
            "robot from the tables",
        )


def _find_delay(tracks: Sequence[DrivenTrack], steps: PoseSteps, expected_s: float) -> float:
    """Find the delay after which the commands explain most of the motion [s].

    If several delays explain nearly as much (EXPLAINED_TOLERANCE), the result is the one nearest to
    the expected delay.
    """
    delays_s = expected_s + DELAY_OFFSETS_S
    is_seen = steps.duration_s < _duration_limit(steps)
    measured_rates = _usual_rates(steps.select(is_seen))
    explained_fractions = np.zeros(len(delays_s))
    for i, delay_s in enumerate(delays_s.tolist()):
        commanded_rates = (
            np.concatenate([track.sent(delay_s) for track in tracks]) / steps.duration_s[:, None]
        )
        explained_fractions[i] = _explained_fraction(measured_rates, commanded_rates[is_seen])
    is_peak = (
        explained_fractions == maximum_filter1d(explained_fractions, 2 * PEAK_HALF_WIDTH + 1)
    ) & (explained_fractions >= explained_fractions.max() - EXPLAINED_TOLERANCE)
    peak_delays_s = delays_s[is_peak]
    return float(peak_delays_s[np.abs(peak_delays_s - expected_s).argmin()])


def _usual_rates(steps: PoseSteps) -> Floats:
    """Compute the turning rate and the speeds ahead and aside in each step, shape (3, S).

    The values are clipped to usual values, because a tracker may confuse two bodies.
    """
    rates = (
        np.stack([steps.turn_rad, steps.displacement.real, steps.displacement.imag])
        / steps.duration_s
    )
    lower, upper = np.quantile(
        rates, (CLIPPED_QUANTILE, 1 - CLIPPED_QUANTILE), axis=1, keepdims=True
    )
    return np.clip(rates, lower, upper)


def _explained_fraction(measured_rates: Floats, commanded_rates: Floats) -> float:
    """Compute the fraction of a motion (3, S) that the commanded rates (S, 2) explain.

    The motion is turning rate, speed ahead and speed aside. If the robot does not turn in the
    commanded sense, the fraction is multiplied by REVERSED_TURN_FACTOR.
    """
    turn_rate, speed_ahead, speed_aside = measured_rates
    commanded_speed, commanded_turn_rate = commanded_rates.T
    turn_correlation = _correlate(commanded_turn_rate, turn_rate)
    distance_correlation = math.hypot(
        _correlate(commanded_speed, speed_ahead), _correlate(commanded_speed, speed_aside)
    )
    unexplained = (1 - turn_correlation**2) * (1 - min(distance_correlation, 1.0) ** 2)
    return (1 - unexplained) * (1.0 if turn_correlation > 0 else REVERSED_TURN_FACTOR)


def _correlate(first_series: Floats, second_series: Floats) -> float:
    """Compute the correlation of two series (S,). It is 0 if one of them never changes."""
    first_deviations = first_series - first_series.mean()
    second_deviations = second_series - second_series.mean()
    lengths = float(np.linalg.norm(first_deviations) * np.linalg.norm(second_deviations))
    return float(first_deviations @ second_deviations) / (lengths + 1e-300)


def _far_off(measured: Floats, command_integrals: Floats, is_driving: Bools) -> Bools:
    """Find the steps (S,) that are far from the regression of all driven steps.

    A step is far if its residual exceeds OUTLIER_FACTOR times the usual residual, and also exceeds
    what commands could explain that act up to NEIGHBOURS_CHECKED steps earlier or later. The second
    condition matters in a track without noise, where ordinary steps differ only by the timing of
    commands.
    """
    expected = command_integrals @ fit_robust_gains(
        measured[is_driving], command_integrals[is_driving]
    )
    residuals = np.abs(measured - expected)
    usual_residual = STD_OF_MEDIAN * np.median(residuals[is_driving])
    window = 2 * NEIGHBOURS_CHECKED + 1
    expected_changes = maximum_filter1d(expected, window) - minimum_filter1d(expected, window)
    return residuals > OUTLIER_FACTOR * usual_residual + expected_changes + 1e-9
