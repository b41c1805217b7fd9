"""A player of recorded trials that keys control, and the state of a trial at one instant."""

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
    """The state of a trial of N robots at one instant, as a view shows it.

    Up to this instant, the trial has had M camera frames and K control steps. Lengths are in the
    trial's unit.

    Attributes:
        setup: The constants of the experiment.
        time_s: Time since the first direction sent [s].
        end_s: Duration of the trial [s]. None for a running trial.
        poses: Newest measured poses, shape (N, 3): x, y, heading [rad]. With `result`, the final
            poses of the result.
        trail: Measured positions, shape (M, N, 2). NaN if a robot was untracked.
        step: The newest control step. None before the first step.
        totals: Total error at each control step, shape (K,): the sum of the robots' distances to
            their targets.
        steps_total: Number of control steps of the whole trial. 0 for a running trial.
        result: The result of the trial. None before the end.
        events: The messages of the trial so far, oldest first.
        pose_kind: Where `poses` come from: "measured", or "true" for the result of a simulation.
    """

    setup: Setup
    time_s: float
    end_s: float | None
    poses: Floats
    trail: Floats
    step: Step | None
    totals: Floats
    steps_total: int
    result: Result | None
    events: tuple[Event, ...] = ()
    pose_kind: str = "measured"

    @property
    def distances(self) -> Floats:
        """Distance of each robot to its target, shape (N,) [length unit].

        At the end, these are the errors in the result.
        """
        if self.result is not None:
            return np.array(self.result.robot_errors)
        return self.setup.distances(self.poses[:, :2])


def find_first_positions(trail: Floats, starts: Floats) -> Floats:
    """Find the first measured position of each robot, shape (N, 2).

    The first position of a cell is the place where the tracker found the cell.

    Args:
        trail: Measured positions, shape (M, N, 2). NaN if a robot was untracked.
        starts: Starts in the spec, shape (N, 2), for robots that were never measured.
    """
    positions = np.concatenate([trail, starts[None]])
    first_rows = np.isfinite(positions[..., 0]).argmax(axis=0)
    return positions[first_rows, np.arange(len(starts))]


def find_end_ns(log: TrialLog) -> int:
    """Find the time at which a view of a recorded trial ends, on the log's clock [ns].

    A simulated trial ends when its stop is sent: after the stop, the robots stand still. A trial in
    a lab ends with the last frame that shows the final poses of the result. Later frames may show
    other poses, because cells swim on after the stop.
    """
    last_step_ns = log.steps[-1].command.sent_ns if log.steps else 0
    is_after_last_step = log.mocap_ns >= last_step_ns
    if log.result and not log.start.plant.simulated and is_after_last_step.any():
        held_poses = _hold_last_poses(log.mocap, log.valid, log.start.setup.starts.array())[1:]
        positions = held_poses[is_after_last_step, :, :2]
        gaps_to_final = np.abs(positions - log.result.verdict.final.xy).max(axis=(1, 2))
        nearest_frames = np.flatnonzero(gaps_to_final == gaps_to_final.min())
        return int(log.mocap_ns[is_after_last_step][nearest_frames[-1]])
    if log.stop:
        return max(last_step_ns, log.stop.sent_ns)
    if log.result:
        return max(last_step_ns, log.began_ns + round(log.result.duration_s * SECOND))
    last_frame_ns = int(log.mocap_ns[-1]) if len(log.mocap_ns) else 0
    return max(last_step_ns, last_frame_ns)


class Recording:
    """A recorded trial whose state at any time can be read with `moment_at`.

    Attributes:
        log: The log of the trial.
        step_ns: When the command of each control step was sent, on the log's clock, shape (K,)
            [ns].
        end_ns: When the trial ends for its viewers, on the log's clock [ns].
        events: The messages of the trial, oldest first. Their times count from the first direction.
        event_ns: When each event happened, on the log's clock [ns].
        totals: Total error at each control step, shape (K,) [length unit].
    """

    def __init__(self, log: TrialLog) -> None:
        self.log = log
        self.step_ns = np.array([step.command.sent_ns for step in log.steps], dtype=np.int64)
        self.end_ns = find_end_ns(log)
        self.events = log.events
        self._event_s = [event.time_s for event in self.events]
        self.event_ns = np.array(sorted(note.t_ns for note in log.notes), dtype=np.int64)
        self.totals = np.array(
            [log.start.setup.distances(step.observation.poses.xy).sum() for step in log.steps]
        )
        self._trail = log.positions
        self._poses = _hold_last_poses(log.mocap, log.valid, log.start.setup.starts.array())

    def moment_at(self, time_ns: int) -> Moment:
        """Return the state of the trial at a time on the log's clock [ns].

        At the end of the trial and later, the state has the result, the final poses and all events.
        """
        log = self.log
        n_frames = int(np.searchsorted(log.mocap_ns, time_ns, side="right"))
        n_steps = int(np.searchsorted(self.step_ns, time_ns, side="right"))
        result = log.result if time_ns >= self.end_ns else None
        events_until_s = log.elapsed_s(time_ns) if result is None else math.inf
        return Moment(
            setup=log.start.setup,
            time_s=log.elapsed_s(time_ns),
            end_s=log.elapsed_s(self.end_ns),
            poses=self._poses[n_frames] if result is None else result.verdict.final.array(),
            trail=self._trail[:n_frames],
            step=log.steps[n_steps - 1] if n_steps else None,
            totals=self.totals[:n_steps],
            steps_total=len(log.steps),
            result=result,
            events=self.events[: bisect_right(self._event_s, events_until_s)],
            pose_kind="true" if result and log.start.plant.simulated else "measured",
        )


def _hold_last_poses(mocap: Floats, valid: NDArray[np.bool_], initial_poses: Floats) -> Floats:
    """Compute each robot's last tracked pose after every frame, shape (M + 1, N, 3).

    Row m contains the poses after m frames. A robot that was not tracked yet has its pose in
    `initial_poses` (N, 3).
    """
    poses = np.concatenate([initial_poses[None], mocap])
    is_tracked = np.vstack([np.ones(len(initial_poses), dtype=bool), valid])
    rows = np.where(is_tracked, np.arange(len(poses))[:, None], 0)
    newest_rows = np.maximum.accumulate(rows, axis=0)
    return poses[newest_rows, np.arange(len(initial_poses))]


SEEK_STEP_NS = SECOND
"""Time by which the arrow keys seek back and forward [ns]."""
RATE_MIN = 1 / 16
"""Minimum playing speed that keys can set [s of the trial per s]."""
RATE_MAX = 64.0
"""Maximum playing speed that keys can set [s of the trial per s]."""


class Playback(StrEnum):
    """A state of the player of a recording."""

    PLAYING = "playing"
    PAUSED = "paused"
    ENDED = "end"  # paused at the end of the played span
    QUIT = "quit"


class Player:
    """A player that moves through a span of a recording, controlled by keys.

    Call `update` before you read `now_ns`, and call `press` with the name of each pressed key:

    - "space" pauses and resumes. At the end, it plays again from the start.
    - "left" and "right" seek 1 s back and forward.
    - "home" and "end" go to the start and the end of the span.
    - "." and "," go to the next and the previous control step, and pause.
    - "e" and "E" go to the next and the previous event, and pause.
    - "+" and "-" double and halve the playing speed.
    - "q" quits.

    Args:
        recording: The recording.
        wall: The wall clock.
        span_ns: Begin and end of the played span, on the log's clock [ns].
        rate: Playing speed, as a multiple of the wall clock.
        loop: Whether to play again from the start after the end.
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
        self._is_paused = paused
        # the trial's time, and the wall clock's, at the last change of rate, pause or position
        self._anchor_ns = self.start_ns
        self._anchor_wall_ns = wall.now()

    @property
    def now_ns(self) -> int:
        """The time in the trial that the player shows now, on the log's clock [ns].

        This time is never later than the end of the played span.
        """
        elapsed_ns = 0
        if not self._is_paused:
            elapsed_ns = round(self.rate * (self._wall.now() - self._anchor_wall_ns))
        return min(self._anchor_ns + elapsed_ns, self.until_ns)

    @property
    def state(self) -> Playback:
        """The state of the player: playing, paused, ended, or quit.

        A player that is paused at the end of the played span has ended.
        """
        if self._quit:
            return Playback.QUIT
        if not self._is_paused:
            return Playback.PLAYING
        return Playback.ENDED if self.now_ns == self.until_ns else Playback.PAUSED

    def update(self) -> None:
        """Pause at the end of the played span or, with `loop`, play again from the start.

        Before the end, nothing happens.
        """
        if self.now_ns == self.until_ns and not self._is_paused:
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
                self._pause(not self._is_paused)
            case "left":
                self._seek(self.now_ns - SEEK_STEP_NS)
            case "right":
                self._seek(self.now_ns + SEEK_STEP_NS)
            case "home":
                self._seek(self.start_ns)
            case "end":
                self._pause_at(self.until_ns)
            case ".":
                self._pause_at(self._find_next(self.recording.step_ns, self.until_ns))
            case ",":
                self._pause_at(self._find_previous(self.recording.step_ns, self.start_ns))
            case "e":
                self._pause_at(self._find_next(self.recording.event_ns, self.now_ns))
            case "E":
                self._pause_at(self._find_previous(self.recording.event_ns, self.now_ns))
            case "+":
                self._set_rate(min(2 * self.rate, max(RATE_MAX, self.rate)))
            case "-":
                self._set_rate(max(self.rate / 2, min(RATE_MIN, self.rate)))
            case "q":
                self._quit = True

    def _pause(self, paused: bool = True) -> None:
        self._anchor_at(self.now_ns)
        self._is_paused = paused

    def _set_rate(self, rate: float) -> None:
        self._anchor_at(self.now_ns)
        self.rate = rate

    def _seek(self, time_ns: int) -> None:
        self._anchor_at(min(max(time_ns, self.start_ns), self.until_ns))

    def _pause_at(self, time_ns: int) -> None:
        self._pause()
        self._seek(time_ns)

    def _anchor_at(self, time_ns: int) -> None:
        self._anchor_ns = time_ns
        self._anchor_wall_ns = self._wall.now()

    def _find_next(self, times: Integers, otherwise: int) -> int:
        """Find the first of the increasing `times` [ns] after the player's present time.

        A time that equals the present time does not count. If there is no later time, the result is
        `otherwise`.
        """
        index = int(np.searchsorted(times, self.now_ns, side="right"))
        return int(times[index]) if index < len(times) else otherwise

    def _find_previous(self, times: Integers, otherwise: int) -> int:
        """Find the last of the increasing `times` [ns] before the player's present time.

        A time that equals the present time does not count. If there is no earlier time, the result
        is `otherwise`.
        """
        index = int(np.searchsorted(times, self.now_ns, side="left"))
        return int(times[index - 1]) if index else otherwise


def span(recording: Recording, start_s: float, until_s: float | None) -> tuple[int, int]:
    """Compute the first and the last instant to play, on the log's clock [ns].

    Args:
        recording: The recording.
        start_s: When to start, counted from the first direction [s]. It is negative if the log
            begins before the first direction.
        until_s: When to end [s]. None for the end of the recording.

    Raises:
        UsageError: If the span is empty.
    """
    first_s = recording.log.elapsed_s(0)
    end_s = recording.log.elapsed_s(recording.end_ns)
    if not start_s >= first_s:
        begin_text = f"at {first_s:.4g}" if first_s else "with the first command, at 0"
        raise UsageError(f"--start {start_s:g} lies before the log, which begins {begin_text}")
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
