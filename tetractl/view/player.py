"""A player of recorded trials, controlled by keys, and the state of a trial at an instant."""

import math
from bisect import bisect_right
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats, Integers
from tetractl.core.setup import Setup
from tetractl.core.trial import Result, Step
from tetractl.log.read.trial_log import Event, TrialLog


@dataclass(frozen=True, slots=True)
class Moment:
    """All that a view shows of a trial of N robots at one instant.

    M frames and K control steps have come before the instant. Lengths are in the trial's unit.

    Attributes:
        setup: The constants of the experiment.
        time_s: Time since the first direction sent [s].
        end_s: Duration of the trial [s]. None for a running trial.
        poses: Newest measured poses, shape (N, 3). With `result`, the poses at which it was taken.
        trail: Measured positions, shape (M, N, 2). NaN if a robot was untracked.
        step: The newest control step.
        totals: Total error at each step, shape (K,).
        steps_end: Number of control steps of the trial. 0 for a running trial.
        result: The result. None before the end.
        events: The messages so far, oldest first.
        known: "measured", or "true" for a result of a simulation.
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
    known: str = "measured"

    @property
    def distances(self) -> Floats:
        """Distance of each robot to its target, shape (N,) [length unit].

        At the end, these are the errors in the result.
        """
        if self.result is not None:
            return np.array(self.result.robot_errors)
        return self.setup.distances(self.poses[:, :2])


def first_seen(trail: Floats, starts: Floats) -> Floats:
    """Return where each robot was first measured in a trail (M, N, 2), as an array (N, 2).

    A robot that was never seen gets its start in the spec, from `starts` (N, 2). Cells start where
    they are found.
    """
    positions = np.concatenate([trail, starts[None]])
    first = np.isfinite(positions[..., 0]).argmax(axis=0)
    return positions[first, np.arange(len(starts))]


def end_ns(log: TrialLog) -> int:
    """Return the time at which a recorded trial ends for its viewers [ns].

    A simulated trial ends with its stop, after which its robots stand still in its last frames. In
    a lab, it ends with the last frame that shows the poses of its result; cells that swim on leave
    these poses before the last frame.
    """
    last_step_ns = log.steps[-1].command.sent_ns if log.steps else 0
    after = log.mocap_ns >= last_step_ns
    if log.result and not log.start.plant.simulated and after.any():
        held = _held(log.mocap, log.valid, log.start.setup.starts.array())[1:]
        positions = held[after, :, :2]
        gaps = np.abs(positions - log.result.verdict.final.xy).max(axis=(1, 2))
        nearest = np.flatnonzero(gaps == gaps.min())
        return int(log.mocap_ns[after][nearest[-1]])
    if log.stop:
        return max(last_step_ns, log.stop.sent_ns)
    if log.result:
        return max(last_step_ns, log.began_ns + round(log.result.duration_s * SECOND))
    last_frame_ns = int(log.mocap_ns[-1]) if len(log.mocap_ns) else 0
    return max(last_step_ns, last_frame_ns)


class Recording:
    """A recorded trial, of which `at` returns the state at any time.

    Times [ns] are on the trial's clock. A control step begins when its command is sent; `event_ns`
    are the times of events. Users are shown times since the first direction: `log.elapsed_s`.
    """

    def __init__(self, log: TrialLog) -> None:
        self.log = log
        self.step_ns = np.array([step.command.sent_ns for step in log.steps], dtype=np.int64)
        self.end_ns = end_ns(log)
        self.events = log.events
        self._event_s = [event.time_s for event in self.events]
        self.event_ns = np.array(sorted(note.t_ns for note in log.notes), dtype=np.int64)
        self.totals = np.array(
            [log.start.setup.distances(step.observation.poses.xy).sum() for step in log.steps]
        )
        self._trail = log.positions
        self._poses = _held(log.mocap, log.valid, log.start.setup.starts.array())

    def at(self, time_ns: int) -> Moment:
        """Return the state of the trial at a time on the log's clock [ns].

        From the end of the trial on, it has the result, the final poses and all events.
        """
        log = self.log
        frames = int(np.searchsorted(log.mocap_ns, time_ns, side="right"))
        steps = int(np.searchsorted(self.step_ns, time_ns, side="right"))
        result = log.result if time_ns >= self.end_ns else None
        until_s = log.elapsed_s(time_ns) if result is None else math.inf
        return Moment(
            setup=log.start.setup,
            time_s=log.elapsed_s(time_ns),
            end_s=log.elapsed_s(self.end_ns),
            poses=self._poses[frames] if result is None else result.verdict.final.array(),
            trail=self._trail[:frames],
            step=log.steps[steps - 1] if steps else None,
            totals=self.totals[:steps],
            steps_end=len(log.steps),
            result=result,
            events=self.events[: bisect_right(self._event_s, until_s)],
            known="true" if result and log.start.plant.simulated else "measured",
        )


def _held(mocap: Floats, valid: NDArray[np.bool_], first: Floats) -> Floats:
    """Return each robot's last tracked pose after every frame, shape (M + 1, N, 3).

    Row m holds the poses after m frames. A robot that was not tracked yet has its pose in `first`
    (N, 3).
    """
    poses = np.concatenate([first[None], mocap])
    tracked_rows = np.vstack([np.ones(len(first), dtype=bool), valid])
    rows = np.where(tracked_rows, np.arange(len(poses))[:, None], 0)
    newest = np.maximum.accumulate(rows, axis=0)
    return poses[newest, np.arange(len(first))]


SEEK_NS = SECOND
"""Time by which the arrow keys seek back and forward [ns]."""
RATE_MIN = 1 / 16
RATE_MAX = 64.0
"""Maximum rate that keys reach [s of the trial per s]. RATE_MIN is the minimum rate."""


class Playback(StrEnum):
    """The states that the player of a recording can be in."""

    PLAYING = "playing"
    PAUSED = "paused"
    ENDED = "end"  # paused at the end of the span
    QUIT = "quit"


class Player:
    """A player that shows a span of a recording, controlled by keys.

    Call `update` before reading `now`, and `press` with the name of each key: "space" pauses and
    resumes, and at the end plays again from the start. "left" and "right" seek 1 s back and
    forward, "home" and "end" go to the ends of the span. "." and "," go to the next and the
    previous control step, "e" and "E" to the next and the previous event, and pause. "+" and "-"
    double and halve the rate, "q" quits.

    Args:
        recording: The recording.
        wall: The wall clock.
        span_ns: Begin and end of the span [ns].
        rate: Playing speed, as a multiple of the wall clock.
        loop: Whether to begin again at the end.
        paused: Whether to start in a pause.
    """

    def __init__(
        self,
        recording: Recording,
        wall: Clock,
        span_ns: tuple[int, int],
        *,
        rate: float = 1.0,
        loop: bool = False,
        paused: bool = False,
    ) -> None:
        self.start_ns, self.until_ns = span_ns
        self.recording = recording
        self._loop = loop
        self._quit = False
        self.rate = rate  # seconds of the trial per second
        self._wall = wall
        self._paused = paused
        # the trial's time and the wall clock's at the last change of rate, pause or place
        self._anchor_ns = self.start_ns
        self._anchor_wall_ns = wall.now()

    @property
    def now(self) -> int:
        """The time of the trial that the player shows [ns].

        It is never later than the end of the span to play.
        """
        passed_ns = 0
        if not self._paused:
            passed_ns = round(self.rate * (self._wall.now() - self._anchor_wall_ns))
        return min(self._anchor_ns + passed_ns, self.until_ns)

    @property
    def state(self) -> Playback:
        """The state of the player.

        At the end of the span, it is ENDED once the player is paused.
        """
        if self._quit:
            return Playback.QUIT
        if not self._paused:
            return Playback.PLAYING
        return Playback.ENDED if self.now == self.until_ns else Playback.PAUSED

    def update(self) -> None:
        """At the end of the span, pause or, with `loop`, begin again.

        Before the end, do nothing.
        """
        if self.now == self.until_ns and not self._paused:
            if self._loop:
                self._seek(self.start_ns)
            else:
                self._pause()

    def press(self, key: str) -> None:
        """Carry out the function of a key, given by its name, such as "space".

        Unknown keys are ignored.
        """
        match key:
            case "space":
                if self.state is Playback.ENDED:
                    self._seek(self.start_ns)
                self._pause(not self._paused)
            case "left":
                self._seek(self.now - SEEK_NS)
            case "right":
                self._seek(self.now + SEEK_NS)
            case "home":
                self._seek(self.start_ns)
            case "end":
                self._pause_at(self.until_ns)
            case ".":
                self._pause_at(self._after(self.recording.step_ns, self.until_ns))
            case ",":
                self._pause_at(self._before(self.recording.step_ns, self.start_ns))
            case "e":
                self._pause_at(self._after(self.recording.event_ns, self.now))
            case "E":
                self._pause_at(self._before(self.recording.event_ns, self.now))
            case "+":
                self._set_rate(min(2 * self.rate, max(RATE_MAX, self.rate)))
            case "-":
                self._set_rate(max(self.rate / 2, min(RATE_MIN, self.rate)))
            case "q":
                self._quit = True

    def _pause(self, paused: bool = True) -> None:
        self._anchor_at(self.now)
        self._paused = paused

    def _set_rate(self, rate: float) -> None:
        self._anchor_at(self.now)
        self.rate = rate

    def _seek(self, time_ns: int) -> None:
        self._anchor_at(min(max(time_ns, self.start_ns), self.until_ns))

    def _pause_at(self, time_ns: int) -> None:
        self._pause()
        self._seek(time_ns)

    def _anchor_at(self, time_ns: int) -> None:
        self._anchor_ns = time_ns
        self._anchor_wall_ns = self._wall.now()

    def _after(self, times: Integers, otherwise: int) -> int:
        """Return the first of the increasing `times` [ns] that lies after now, or `otherwise`.

        A time that equals now does not count.
        """
        index = int(np.searchsorted(times, self.now, side="right"))
        return int(times[index]) if index < len(times) else otherwise

    def _before(self, times: Integers, otherwise: int) -> int:
        """Return the last of the increasing `times` [ns] that lies before now, or `otherwise`.

        A time that equals now does not count.
        """
        index = int(np.searchsorted(times, self.now, side="left"))
        return int(times[index - 1]) if index else otherwise


def span(recording: Recording, start_s: float, until_s: float | None) -> tuple[int, int]:
    """Return the times [ns] of the first and last instant to play.

    Args:
        recording: The recording.
        start_s: When to start, counted from the first direction [s]. The log may begin before it.
        until_s: When to end [s]. None for the end of the recording.

    Raises:
        UsageError: If the span is empty.
    """
    first_s = recording.log.elapsed_s(0)
    end_s = recording.log.elapsed_s(recording.end_ns)
    if not start_s >= first_s:
        begins = f"at {first_s:.4g}" if first_s else "with the first command, at 0"
        raise UsageError(f"--start {start_s:g} lies before the log, which begins {begins}")
    if start_s > end_s:
        raise UsageError(
            f"--start {start_s:g} lies after the end of the trial, which lasts {end_s:g} s"
        )
    if until_s is not None and not start_s < until_s:
        raise UsageError(f"--start {start_s:g} must lie before --until {until_s:g}")
    began_ns = recording.log.began_ns
    if until_s is None or until_s > end_s:
        return began_ns + round(SECOND * start_s), recording.end_ns
    return began_ns + round(SECOND * start_s), began_ns + round(SECOND * until_s)
