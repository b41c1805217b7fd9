"""The data of identification: tracked poses of robots and the directions sent to them, of logs."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import FieldOff, Steer
from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats, Integers
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.wheels import body_velocity

SETTLED_S = 0.5
"""Time from the first direction after a pause until all robots drive again."""
ROUNDING_S = 1e-6
"""How much shorter a time between two poses may be because of rounding [s].

Times may be counted from 1970, and floats near Unix times are 2.4e-7 s apart.
"""


@dataclass(frozen=True, slots=True)
class Track:
    """One trial of N robots: M camera frames and C commands, times in seconds of one clock.

    `time` (M,) is when each frame was exposed, `poses` (M, N, 3) are x, y [length unit] and heading
    [rad], `valid` (M, N) is False if a robot was not tracked. `sent` (C,) is when each command was
    sent and `u` (C,) its direction [rad]. Data after `until` [s], when the robots receive a stop,
    are not used. `frame_age` is the median time [s] from a frame's exposure to the sending of the
    command decided on it, None if unknown. Robots that receive nothing for `watchdog` [s] stop;
    their wheels follow with the time constant `lag` [s], which is 0 also of robots that are
    `on_wheels` whose lag nothing states. `strength` is that of the field in `strength_unit`, None
    if the spec does not state it. `twists` (C, N, 2) are speed [length unit/s] and turning rate
    [rad/s] that each robot was sent, NaN where it was sent none; without any, C is 0. `own_times`
    (M, N) are those of robots' poses [s], `time` for all if it is empty. `unreached` (M, N) is True
    while a robot does not follow the newest command, because the log knows that it did not receive
    it; if it is empty, nothing is known of lost commands. `all_commands` is False of
    lagging wheels that were sent others between these, and `rates_unstated` True of those of which
    nothing states whether they steer themselves, or a host sends them rates that foresee their lag.
    `two_clocks` is True if the times of poses and commands may be of different clocks, as in tables
    of other programs. `commands_source` is the file of the commands if it is not `source`.
    `remarks` are lines for the user on the data.
    """

    source: str
    origin: str
    unit: str
    names: tuple[str, ...]
    time: Floats
    poses: Floats
    valid: Bools
    sent: Floats
    u: Floats
    until: float
    frame_age: float | None = None
    watchdog: float = math.inf
    lag: float = 0.0
    on_wheels: bool = False
    strength: float | None = None
    strength_unit: str = "mT"
    twists: Floats = field(default_factory=lambda: np.zeros((0, 0, 2)))
    own_times: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    unreached: Bools = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    all_commands: bool = True
    rates_unstated: bool = False
    two_clocks: bool = False
    commands_source: str = ""
    remarks: tuple[str, ...] = ()

    @property
    def sources(self) -> tuple[str, ...]:
        """The files of the poses and of the commands."""
        return tuple(filter(None, (self.source, self.commands_source)))

    @property
    def exposed(self) -> Floats:
        """The times of the poses (M, N) [s]."""
        if self.own_times.size:
            return self.own_times
        return np.repeat(self.time[:, None], len(self.names), axis=1)

    @property
    def commanded(self) -> Bools:
        """The poses (M, N) of robots that follow their newest command, as far as the log knows."""
        return self.valid & ~self.unreached if self.unreached.size else self.valid


def rows_apart(times: Floats, least_s: float, last_s: float = -math.inf) -> Integers:
    """Select rows with a minimum time between them, (K,).

    Args:
        times: Increasing times [s], shape (M,).
        least_s: Minimum time between two rows [s].
        last_s: The first row is after this time [s].
    """
    rows: list[int] = []
    for row, time_s in enumerate(times.tolist()):
        if time_s - last_s >= least_s - ROUNDING_S:
            rows.append(row)
            last_s = time_s
    return np.array(rows, dtype=np.int64)


def integrals_of_sent(sent_s: Floats, rates: Floats, times: Floats) -> Floats:
    """Integrate rates that are each held until the next one, up to given times, (M, K).

    Args:
        sent_s: When each rate was sent [s], shape (C,).
        rates: The rates, shape (C, K).
        times: The times [s], shape (M,).
    """
    total = np.zeros_like(rates)
    total[1:] = np.cumsum(np.diff(sent_s)[:, None] * rates[:-1], axis=0)
    return np.column_stack([np.interp(times, sent_s, column) for column in total.T])


def track_of(log: TrialLog) -> Track:
    """Return the track of a log: measured poses and commands, never the true poses.

    Raises:
        UsageError: If its robots sometimes drove with the field off.
    """
    if any(isinstance(command.action, FieldOff) for command in log.commands):
        raise UsageError(
            f"{log.log}: its robots drove with the field off at times",
            "use the log of a controller that sends a direction at every step",
        )
    setup = log.start.setup
    directed = [command for command in log.commands if command.direction is not None]
    if not directed and log.steps:
        directed = [step.command for step in log.steps]
    ages_ns = [step.command.sent_ns - step.observation.sampled_ns for step in log.steps[1:]]
    last_ns = stopped_ns(log)
    if last_ns is None:
        last_ns = max((command.sent_ns for command in directed), default=0)
    return Track(
        source=log.log,
        origin=log.origin.value,
        unit=setup.unit,
        names=setup.names,
        time=log.mocap_ns / SECOND,
        poses=log.mocap,
        own_times=log.exposed_ns / SECOND,
        valid=log.valid & ~_paused(log)[:, None],
        unreached=_unreached(log),
        sent=np.array([command.sent_ns for command in directed], dtype=float) / SECOND,
        u=np.array([command.direction for command in directed], dtype=float),
        until=last_ns / SECOND,
        frame_age=float(np.median(ages_ns)) / SECOND if ages_ns else None,
        watchdog=setup.watchdog_s,
        lag=_lag_assumed(log),
        on_wheels=setup.on_wheels,
        strength=setup.strength,
        strength_unit=setup.strength_unit,
    )


def _lag_assumed(log: TrialLog) -> float:
    """Return the lag of the wheels that their host assumed at the end of a trial [s].

    It is the lag that the controller has found and sent with its directions, or the spec's.
    """
    actions = (step.command.action for step in reversed(log.steps))
    sent = (action.lag_s for action in actions if isinstance(action, Steer))
    return next((lag_s for lag_s in sent if lag_s is not None), log.start.setup.lag_s)


def wheels_of(log: TrialLog) -> Track:
    """Return the track of a log with the speeds and turning rates sent to wheels.

    They are computed by (21)-(23) with the spec's radius.

    Raises:
        UsageError: If the robots have no wheels.
    """
    radius = log.start.setup.wheel_radius
    track = track_of(log)
    sent_ns: list[int] = []
    left_speeds: list[Floats] = []
    right_speeds: list[Floats] = []
    for command in log.commands:
        if command.left is not None and command.right is not None:
            sent_ns.append(command.sent_ns)
            left_speeds.append(command.left)
            right_speeds.append(command.right)
    if not sent_ns or radius is None:
        raise UsageError(f"{log.log}: has no speeds of wheels")
    velocity = body_velocity(np.array(left_speeds), np.array(right_speeds), radius)
    twists = np.stack(velocity, axis=-1)
    no_directions = np.full(len(sent_ns), math.nan)
    return replace(track, sent=np.array(sent_ns) / SECOND, u=no_directions, twists=twists)


def _paused(log: TrialLog) -> Bools:
    """Find the frames (M,) exposed between a stop and SETTLED_S after the next direction.

    In these, the robots stop, stand still, or start to drive.
    """
    directed_ns = [command.sent_ns for command in log.commands if command.direction is not None]
    stops_ns = [command.sent_ns for command in log.commands if command.stops]
    paused = np.zeros(len(log.mocap_ns), dtype=np.bool_)
    for stop_ns in stops_ns:
        again_ns = min((sent_ns for sent_ns in directed_ns if sent_ns > stop_ns), default=None)
        if again_ns is not None:
            until_ns = again_ns + round(SETTLED_S * SECOND)
            paused |= (log.mocap_ns >= stop_ns) & (log.mocap_ns < until_ns)
    return paused


def _unreached(log: TrialLog) -> Bools:
    """Find the frames at which a robot does not follow the newest command, shape (M, N).

    A robot that did not receive a command keeps its former speeds, and stops after the time of its
    watchdog. It follows again SETTLED_S after the next command that it receives.
    """
    unreached = np.zeros(log.valid.shape, dtype=np.bool_)
    settled_ns = round(SETTLED_S * SECOND)
    for robot in range(len(log.start.setup.names)):
        lost_ns: int | None = None
        for command in log.commands:
            if not command.delivered[robot]:
                lost_ns = command.sent_ns if lost_ns is None else lost_ns
            elif lost_ns is not None:
                again_ns = command.sent_ns + settled_ns
                unreached[:, robot] |= (log.mocap_ns >= lost_ns) & (log.mocap_ns < again_ns)
                lost_ns = None
        if lost_ns is not None:
            unreached[:, robot] |= log.mocap_ns >= lost_ns
    return unreached


def stopped_ns(log: TrialLog) -> int | None:
    """Return when the first stop after the last direction was sent [ns], None if that is not known.

    A lab sends several stops at the end; `log.stop` is the last of them.
    """
    directed_ns = [command.sent_ns for command in log.commands if command.direction is not None]
    last_ns = max(directed_ns, default=-1)
    stops_ns = [command.sent_ns for command in log.commands if command.direction is None]
    after_ns = [stop_ns for stop_ns in stops_ns if stop_ns > last_ns]
    if after_ns:
        return min(after_ns)
    return log.stop.sent_ns if log.stop else None


def require_same(tracks: list[Track]) -> None:
    """Raise UsageError if tracks are not of the same robots in the same unit and field."""
    first = tracks[0]
    for track in tracks[1:]:
        if (track.strength, track.strength_unit) != (first.strength, first.strength_unit):
            raise UsageError(
                f"{track.source}: the field's strength differs from that of {first.source}",
                "identify them separately: a depends on it",
            )
        if (track.names, track.unit) != (first.names, first.unit):
            raise UsageError(
                f"{track.source}: robots or length unit differ from those of {first.source}",
                "identify them separately",
            )
