"""The input of identification: measured poses of robots and the commands sent to them."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import FieldOff, Steer
from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats, Integers
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.wheels import compute_body_velocity

SETTLING_S = 0.5
"""Time after the first direction that follows a pause until all robots drive again [s]."""
ROUNDING_S = 1e-6
"""How much shorter a time between two poses may be because of rounding [s].

Times may be counted from 1970, and floats near Unix times are 2.4e-7 s apart.
"""


@dataclass(frozen=True, slots=True)
class Track:
    """The poses and commands of N robots in one trial: M camera frames and C commands.

    All times are in seconds of one clock.

    Attributes:
        source: The file of the poses, as messages name it.
        origin: Where the data come from, for the title of a table.
        unit: Length unit of the poses and speeds.
        names: Names of the robots, shape (N,).
        time_s: When each frame was exposed [s], shape (M,).
        poses: x, y [length unit] and heading [rad], shape (M, N, 3).
        valid: False where a robot was not tracked, or paused between two stretches of driving,
            shape (M, N).
        sent_s: When each command was sent [s], shape (C,).
        direction_rad: Direction of each command [rad], shape (C,). NaN if the track has `twists`
            instead.
        stop_s: When the robots receive a stop [s]. Later data are not used.
        frame_age_s: Median time from the exposure of a frame to the sending of the command decided
            on it [s]. None if unknown.
        watchdog_s: Robots that receive nothing for this time stop [s].
        lag_s: Time constant with which wheels follow [s]. It is 0 if the robots have no wheels, and
            also if they are `on_wheels` and nothing states their lag.
        on_wheels: Whether the robots have wheels.
        strength: Strength of the field, in `strength_unit`. None if the spec does not state it.
        strength_unit: Unit of the strength.
        twists: Speed [length unit/s] and turning rate [rad/s] that each robot was sent, shape (C,
            N, 2). NaN if a robot was sent nothing, or did not receive it. C is 0 if none were sent.
        exposed_by_robot_s: Times of each robot's poses [s], shape (M, N). If it is empty, they are
            `time_s`.
        is_received: False where the log states that a robot did not receive a command, which then
            follows the command before, shape (C, N). If it is empty, nothing is known.
        is_silent: True while a robot does not drive as it was commanded, because it received
            nothing for too long, shape (M, N). If it is empty, nothing is known.
        has_all_commands: Whether the robots followed only these commands. False if their wheels lag
            and they were sent other commands between these.
        rates_unstated: Whether it is unknown who steers robots with lagging wheels: the robots
            themselves, or a host that sends rates which foresee the lag.
        has_two_clocks: Whether the times of poses and commands may come from different clocks, as
            in tables of other programs.
        commands_source: The file of the commands, if it is not `source`.
        remarks: Lines for the user about the data.
    """

    source: str
    origin: str
    unit: str
    names: tuple[str, ...]
    time_s: Floats
    poses: Floats
    valid: Bools
    sent_s: Floats
    direction_rad: Floats
    stop_s: float
    frame_age_s: float | None = None
    watchdog_s: float = math.inf
    lag_s: float = 0.0
    on_wheels: bool = False
    strength: float | None = None
    strength_unit: str = "mT"
    twists: Floats = field(default_factory=lambda: np.zeros((0, 0, 2)))
    exposed_by_robot_s: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    is_received: Bools = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    is_silent: Bools = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    has_all_commands: bool = True
    rates_unstated: bool = False
    has_two_clocks: bool = False
    commands_source: str = ""
    remarks: tuple[str, ...] = ()

    @property
    def sources(self) -> tuple[str, ...]:
        """The files that the poses and the commands come from.

        A file that is unknown is left out.
        """
        return tuple(filter(None, (self.source, self.commands_source)))

    @property
    def exposed_s(self) -> Floats:
        """When each robot was exposed in each of M frames, shape (M, N) [s].

        It is the frame's time for all robots, unless each robot has its own times.
        """
        if self.exposed_by_robot_s.size:
            return self.exposed_by_robot_s
        return np.repeat(self.time_s[:, None], len(self.names), axis=1)

    @property
    def follows_commands(self) -> Bools:
        """Whether each pose is valid while its robot follows the commands, shape (M, N).

        If it is unknown when robots follow, only the validity counts.
        """
        return self.valid & ~self.is_silent if self.is_silent.size else self.valid

    def received_by(self, robot: int) -> Bools:
        """Find which commands (C,) a robot received, as far as the log shows.

        If the log does not show it, the result is True for all commands.
        """
        if self.is_received.size:
            return self.is_received[:, robot]
        return np.ones(len(self.sent_s), dtype=np.bool_)


def select_rows_apart(times: Floats, spacing_min_s: float, last_s: float = -math.inf) -> Integers:
    """Select rows (K,) that are at least some time apart.

    Args:
        times: Increasing times [s], shape (M,).
        spacing_min_s: Minimum time between two rows [s].
        last_s: Time of the row before the first one [s].
    """
    rows: list[int] = []
    for row, time_s in enumerate(times.tolist()):
        if time_s - last_s >= spacing_min_s - ROUNDING_S:
            rows.append(row)
            last_s = time_s
    return np.array(rows, dtype=np.int64)


def integrate_held_rates(sent_s: Floats, rates: Floats, times: Floats) -> Floats:
    """Integrate rates up to given times, (M, K). Each rate is held until the next one.

    Args:
        sent_s: When each rate was sent [s], shape (C,).
        rates: The rates, shape (C, K).
        times: The times [s], shape (M,).
    """
    integrals = np.zeros_like(rates)
    integrals[1:] = np.cumsum(np.diff(sent_s)[:, None] * rates[:-1], axis=0)
    return np.column_stack([np.interp(times, sent_s, column) for column in integrals.T])


def extract_track(log: TrialLog) -> Track:
    """Extract the measured poses and commands from a log. The true poses are never used.

    Raises:
        UsageError: If the robots drove with the field off at times.
    """
    if any(isinstance(command.action, FieldOff) for command in log.commands):
        raise UsageError(
            f"{log.log}: the robots drove with the field switched off for part of the trial",
            "use the log of a controller that sends a direction at every step",
        )
    setup = log.start.setup
    directed_commands = [command for command in log.commands if command.direction is not None]
    if not directed_commands and log.steps:
        directed_commands = [step.command for step in log.steps]
    ages_ns = [step.command.sent_ns - step.observation.sampled_ns for step in log.steps[1:]]
    stop_ns = find_stop_ns(log)
    if stop_ns is None:
        stop_ns = max((command.sent_ns for command in directed_commands), default=0)
    return Track(
        source=log.log,
        origin=log.origin.value,
        unit=setup.unit,
        names=setup.names,
        time_s=log.mocap_ns / SECOND,
        poses=log.mocap,
        exposed_by_robot_s=log.exposed_ns / SECOND,
        valid=log.valid & ~_paused(log)[:, None],
        is_silent=_silent(log),
        sent_s=np.array([command.sent_ns for command in directed_commands], dtype=float) / SECOND,
        direction_rad=np.array([command.direction for command in directed_commands], dtype=float),
        is_received=np.array([command.delivered for command in directed_commands], dtype=np.bool_),
        stop_s=stop_ns / SECOND,
        frame_age_s=float(np.median(ages_ns)) / SECOND if ages_ns else None,
        watchdog_s=setup.watchdog_s,
        lag_s=_lag_assumed(log),
        on_wheels=setup.on_wheels,
        strength=setup.strength,
        strength_unit=setup.strength_unit,
    )


def _lag_assumed(log: TrialLog) -> float:
    """Return the lag of the wheels that their host assumed at the end of a trial [s].

    It is the lag that the controller found and sent with its directions, or otherwise the spec's
    lag.
    """
    actions = (step.command.action for step in reversed(log.steps))
    lags_sent_s = (action.lag_s for action in actions if isinstance(action, Steer))
    return next((lag_s for lag_s in lags_sent_s if lag_s is not None), log.start.setup.lag_s)


def extract_wheel_track(log: TrialLog) -> Track:
    """Extract the speeds and turning rates sent to wheels from a log, with the poses.

    They are computed by the paper's equations (21)-(23) with the spec's radius. A robot that did
    not receive a command keeps its previous speeds.

    Raises:
        UsageError: If the robots have no wheels.
    """
    radius = log.start.setup.wheel_radius
    track = extract_track(log)
    sent_ns: list[int] = []
    left_speeds: list[Floats] = []
    right_speeds: list[Floats] = []
    delivered: list[tuple[bool, ...]] = []
    for command in log.commands:
        if command.left is not None and command.right is not None:
            sent_ns.append(command.sent_ns)
            left_speeds.append(command.left)
            right_speeds.append(command.right)
            delivered.append(command.delivered)
    if not sent_ns or radius is None:
        raise UsageError(f"{log.log}: the log has no wheel speeds")
    velocity = compute_body_velocity(np.array(left_speeds), np.array(right_speeds), radius)
    twists = np.stack(velocity, axis=-1)
    received = np.array(delivered)
    twists[~received] = math.nan
    return replace(
        track,
        sent_s=np.array(sent_ns) / SECOND,
        direction_rad=np.full(len(sent_ns), math.nan),
        is_received=received,
        twists=twists,
    )


def _paused(log: TrialLog) -> Bools:
    """Find the frames (M,) exposed between a stop and SETTLED_S after the next direction.

    In these frames, the robots stop, stand still, or start to drive. Frames after the last
    direction are not included.
    """
    directed_ns = [command.sent_ns for command in log.commands if command.direction is not None]
    last_directed_ns = max(directed_ns, default=0)
    stops_ns = [command.sent_ns for command in log.commands if command.stops]
    pauses_ns = [stop_ns for stop_ns in stops_ns if stop_ns < last_directed_ns]
    return _until_settled(log.mocap_ns, np.array(pauses_ns), np.array(directed_ns))


def _silent(log: TrialLog) -> Bools:
    """Find the frames at which a robot had received nothing for too long, shape (M, N).

    A robot that does not receive a command follows the previous one until its watchdog stops it. It
    counts as driving again SETTLED_S after the next command that it receives. At the start, it
    stands still until then.
    """
    is_silent = np.zeros(log.valid.shape, dtype=np.bool_)
    if not log.commands:
        return is_silent
    sent_ns = np.array([command.sent_ns for command in log.commands])
    watchdog_ns = log.start.setup.watchdog_s * SECOND
    delivered = np.array([command.delivered for command in log.commands], dtype=np.bool_)
    for robot, is_received in enumerate(delivered.T):
        received_ns = sent_ns[is_received]
        precedes_silence = np.diff(received_ns, append=math.inf) > watchdog_ns
        silences_ns = received_ns[precedes_silence] + watchdog_ns
        if not is_received[0]:
            silences_ns = np.append(sent_ns[0], silences_ns)
        is_silent[:, robot] = _until_settled(log.mocap_ns, silences_ns, received_ns)
    return is_silent


def _until_settled(
    frames_ns: Integers, interruptions_ns: Integers | Floats, resumptions_ns: Integers | Floats
) -> Bools:
    """Find the frames (M,) at which robots do not drive as commanded.

    Args:
        frames_ns: When each frame was exposed [ns], shape (M,).
        interruptions_ns: Increasing times at which robots stop following their commands, shape (B,)
            [ns].
        resumptions_ns: Increasing times of commands, shape (A,) [ns]. Robots follow again SETTLED_S
            after the next of these commands. Without a further command, they never do.
    """
    ends_ns = np.append(resumptions_ns + SETTLING_S * SECOND, math.inf)
    ends_ns = ends_ns[np.searchsorted(resumptions_ns, interruptions_ns, side="right")]
    n_interruptions = np.searchsorted(interruptions_ns, frames_ns, side="right")
    return frames_ns < np.append(-math.inf, ends_ns)[n_interruptions]


def find_stop_ns(log: TrialLog) -> int | None:
    """Return when the first stop after the last direction was sent [ns]. None if unknown.

    A lab sends several stops at the end. `log.stop` is the last of them.
    """
    directed_ns = [command.sent_ns for command in log.commands if command.direction is not None]
    last_directed_ns = max(directed_ns, default=-1)
    stops_ns = [command.sent_ns for command in log.commands if command.direction is None]
    final_stops_ns = [stop_ns for stop_ns in stops_ns if stop_ns > last_directed_ns]
    if final_stops_ns:
        return min(final_stops_ns)
    return log.stop.sent_ns if log.stop else None


def require_same(tracks: list[Track]) -> None:
    """Check that all tracks have the same robots, length unit and field strength.

    Raises:
        UsageError: If they do not.
    """
    first_track = tracks[0]
    for track in tracks[1:]:
        if (track.strength, track.strength_unit) != (
            first_track.strength,
            first_track.strength_unit,
        ):
            raise UsageError(
                f"{track.source}: the field's strength differs from the strength in "
                f"{first_track.source}",
                "identify these logs separately, because the turning rate a depends on the "
                "strength",
            )
        if (track.names, track.unit) != (first_track.names, first_track.unit):
            raise UsageError(
                f"{track.source}: the robots or the length unit differ from those in "
                f"{first_track.source}",
                "identify them separately",
            )
