"""The state of a trial at one instant, and a recorded trial as a sequence of such instants."""

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import SECOND, seconds
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.core.trial import Result, Step
from tetractl.log.read.trial_log import Event, TrialLog


@dataclass(frozen=True, slots=True)
class Moment:
    """One instant of a trial of N robots after M frames and K control steps; lengths in its unit.

    `time_s` counts from the first direction sent. `poses` (N, 3) are the newest measured poses and
    `trail` (M, N, 2) the measured positions, NaN if a robot was not tracked. `step` is the
    newest control step and `totals` (K,) the total error at each. `end_s` is the duration of the
    trial and `steps_end` the number of its control steps; None and 0 if the trial is not over.
    `events` are the messages so far, oldest first.
    """

    setup: Setup
    time_s: float
    end_s: float | None
    poses: Floats
    trail: Floats
    step: Step | None
    totals: Floats
    steps_end: int
    result: Result | None
    events: tuple[Event, ...] = ()

    @property
    def distances(self) -> Floats:
        """The distance of each robot to its target, shape (N,)."""
        return self.setup.distances(self.poses[:, :2])


def tracked(mocap: Floats, valid: NDArray[np.bool_]) -> Floats:
    """Return positions (M, N, 2) of poses (M, N, 3), NaN if a robot was not tracked."""
    return np.where(valid[..., None], mocap[..., :2], np.nan)


class Recording:
    """A recorded trial, of which `at` returns any instant.

    Times [ns] are on the trial's clock. A control step begins when its command is sent; `began_ns`
    is the time of the first direction, which is 0 for users, and `event_ns` are the times of the
    events.
    """

    def __init__(self, log: TrialLog) -> None:
        self.log = log
        self.step_ns = np.array([step.command.sent_ns for step in log.steps], dtype=np.int64)
        ends = [*log.mocap_ns[-1:], *self.step_ns[-1:]]
        if log.stop:
            ends.append(log.stop.sent_ns)
        elif log.result:
            ends.append(log.began_ns + round(log.result.duration_s * SECOND))
        self.end_ns = int(max(ends, default=0))
        self.began_ns, self.events = log.began_ns, log.events
        self._event_s = [event.time_s for event in self.events]
        self.event_ns = np.array(sorted(note.t_ns for note in log.notes), dtype=np.int64)
        self.totals = np.array(
            [log.start.setup.distances(step.observation.poses.xy).sum() for step in log.steps]
        )
        self._trail = tracked(log.mocap, log.valid)
        self._poses = _held(log.mocap, log.valid, log.start.setup.starts.array())

    def at(self, time_ns: int) -> Moment:
        """Return the instant at a time of the trial [ns]."""
        log = self.log
        seen = int(np.searchsorted(log.mocap_ns, time_ns, side="right"))
        done = int(np.searchsorted(self.step_ns, time_ns, side="right"))
        return Moment(
            setup=log.start.setup,
            time_s=self.elapsed_s(time_ns),
            end_s=self.elapsed_s(self.end_ns),
            poses=self._poses[seen],
            trail=self._trail[:seen],
            step=log.steps[done - 1] if done else None,
            totals=self.totals[:done],
            steps_end=len(log.steps),
            result=log.result if time_ns >= self.end_ns else None,
            events=self.events[: bisect_right(self._event_s, self.elapsed_s(time_ns))],
        )

    def elapsed_s(self, time_ns: int) -> float:
        """Return the time from the first direction to a time of the trial's clock [s]."""
        return seconds(time_ns - self.began_ns)


def _held(mocap: Floats, valid: NDArray[np.bool_], first: Floats) -> Floats:
    """Return poses (M + 1, N, 3), row m after m frames; a robot not tracked keeps its last pose."""
    poses = np.concatenate([first[None], mocap])
    seen = np.vstack([np.ones(len(first), dtype=bool), valid])
    index = np.arange(len(poses))[:, None] * seen
    newest = np.maximum.accumulate(index, axis=0)
    return poses[newest, np.arange(len(first))]
