"""The data of identification: tracked poses of robots and the directions sent to them, of logs."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import FieldOff
from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.wheels import body_velocity

SETTLED_S = 0.5  # time from the first direction after a pause until all robots drive again


@dataclass(frozen=True, slots=True)
class Track:
    """One trial of N robots: M camera frames and C commands, times in seconds of one clock.

    `time` (M,) is when each frame was exposed, `poses` (M, N, 3) are x, y [length unit] and heading
    [rad], `valid` (M, N) is False if a robot was not tracked. `sent` (C,) is when each command was
    sent and `u` (C,) its direction [rad]. Data after `until` [s], when the robots receive a stop,
    are not used. `frame_age` is the median time [s] from a frame's exposure to the sending of the
    command decided on it, None if unknown. `left_out` are robots that were seen too briefly. Robots
    that receive nothing for `watchdog` [s] stop; their wheels follow with the time constant `lag`
    [s], which is 0 also of robots that are `on_wheels` whose lag nothing states. `strength` is that
    of the field in `strength_unit`, None if the spec does not state it. `twists` (C, N, 2) are
    speed [length unit/s] and turning rate [rad/s] that each robot was sent, NaN where it was sent
    none; without any, C is 0. `own` (M, N) are the times of robots' poses [s], `time` for all if it
    is empty. `remarks` are lines for the user on the data.
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
    left_out: tuple[str, ...] = ()
    watchdog: float = math.inf
    lag: float = 0.0
    on_wheels: bool = False
    strength: float | None = None
    strength_unit: str = "mT"
    twists: Floats = field(default_factory=lambda: np.zeros((0, 0, 2)))
    own: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    remarks: tuple[str, ...] = ()

    @property
    def exposed(self) -> Floats:
        """The times of the poses (M, N) [s]."""
        if self.own.size:
            return self.own
        return np.repeat(self.time[:, None], len(self.names), axis=1)


def track_of(log: TrialLog) -> Track:
    """Return the track of a log: measured poses and commands, never the true poses."""
    require_field(log)
    setup = log.start.setup
    sent = [one for one in log.commands if one.direction is not None]
    if not sent and log.steps:
        sent = [step.command for step in log.steps]
    ages = [s.command.sent_ns - s.observation.sampled_ns for s in log.steps[1:]]
    last = stopped_ns(log)
    last = max((one.sent_ns for one in sent), default=0) if last is None else last
    return Track(
        source=log.log,
        origin=log.origin.value,
        unit=setup.unit,
        names=setup.names,
        time=log.mocap_ns / SECOND,
        poses=log.mocap,
        own=log.exposed_ns / SECOND,
        valid=log.valid & ~_paused(log)[:, None],
        sent=np.array([one.sent_ns for one in sent], dtype=float) / SECOND,
        u=np.array([one.direction for one in sent], dtype=float),
        until=last / SECOND,
        frame_age=float(np.median(ages)) / SECOND if ages else None,
        watchdog=setup.watchdog_s,
        lag=setup.lag_s,
        on_wheels=setup.wheel_radius is not None,
        strength=setup.strength,
        strength_unit=setup.strength_unit,
    )


def wheels_of(log: TrialLog) -> Track:
    """Return the track of a log with the speeds and turning rates that wheels were sent, by (21)-
    (23) with the spec's radius; UsageError if the robots have no wheels."""
    setup, track = log.start.setup, track_of(log)
    sent = [(c.sent_ns, c.left, c.right) for c in log.commands]
    driven = [(t, a, b) for t, a, b in sent if a is not None and b is not None]
    if not driven or setup.wheel_radius is None:
        raise UsageError(f"{log.log}: has no speeds of wheels")
    left, right = np.array([[a, b] for _, a, b in driven]).transpose(1, 0, 2)
    twists = np.stack(body_velocity(left, right, setup.wheel_radius), axis=-1)
    when = np.array([t for t, _, _ in driven]) / SECOND
    return replace(track, sent=when, u=np.full(len(when), math.nan), twists=twists)


def _paused(log: TrialLog) -> Bools:
    """Return which frames (M,) were exposed between a stop and SETTLED_S after the next direction:
    the robots stop, stand still, or start to drive.
    """
    sent = [one.sent_ns for one in log.commands if one.direction is not None]
    found = np.zeros(len(log.mocap_ns), dtype=np.bool_)
    for stop in (one.sent_ns for one in log.commands if one.stops):
        again = min((one for one in sent if one > stop), default=None)
        if again is not None:
            until = again + round(SETTLED_S * SECOND)
            found |= (log.mocap_ns >= stop) & (log.mocap_ns < until)
    return found


def require_field(log: TrialLog) -> None:
    """Raise UsageError for a log whose robots drove with the field off at times."""
    if any(isinstance(one.action, FieldOff) for one in log.commands):
        raise UsageError(
            f"{log.log}: its robots drove with the field off at times",
            "use the log of a controller that sends a direction at every step",
        )


def stopped_ns(log: TrialLog) -> int | None:
    """Return when the first stop after the last direction was sent [ns], None if that is not known.

    A lab sends several stops at the end; `log.stop` is the last of them.
    """
    last = max((one.sent_ns for one in log.commands if one.direction is not None), default=-1)
    stops = [one.sent_ns for one in log.commands if one.direction is None and one.sent_ns > last]
    return min(stops, default=log.stop.sent_ns if log.stop else None)


def require_same(tracks: list[Track]) -> None:
    """Raise UsageError if tracks are not of the same robots in the same unit and field."""
    first = tracks[0]
    for other in tracks[1:]:
        if (other.strength, other.strength_unit) != (first.strength, first.strength_unit):
            raise UsageError(
                f"{other.source}: the field's strength differs from that of {first.source}",
                "identify them separately: a depends on it",
            )
        if (other.names, other.unit) != (first.names, first.unit):
            raise UsageError(
                f"{other.source}: robots or length unit differ from those of {first.source}",
                "identify them separately",
            )
