"""The player of a recorded trial: the effect of keys on the time that is shown."""

import math
from enum import StrEnum

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import UsageError
from tetractl.core.trial import Integers
from tetractl.replay.recording import Recording

SEEK_NS = SECOND
RATE_MIN, RATE_MAX = 1 / 16, 64.0


class PlayerClock:
    """A trial's time [ns], `rate` times as fast as the wall clock; it can be paused and set.

    now = anchor + rate * (wall - wall at the anchor). A change of rate, a pause and a jump each set
    a new anchor, so that the time is continuous except for jumps.
    """

    def __init__(
        self, wall: Clock, *, at_ns: int = 0, rate: float = 1.0, paused: bool = False
    ) -> None:
        self._wall = wall
        self._rate = _positive(rate)
        self._paused = paused
        self._anchor = at_ns
        self._anchor_wall = wall.now()

    @property
    def rate(self) -> float:
        """Seconds of the trial per second of wall time."""
        return self._rate

    @property
    def paused(self) -> bool:
        """Whether the clock is paused."""
        return self._paused

    def now(self) -> int:
        """Time of the trial [ns]."""
        if self._paused:
            return self._anchor
        return self._anchor + round(self._rate * (self._wall.now() - self._anchor_wall))

    def sleep_until(self, time_ns: int) -> bool:
        """Wait until a time of the trial, and return True; a paused clock returns at once."""
        if not self._paused:
            wall_ns = math.ceil((time_ns - self._anchor) / self._rate)
            self._wall.sleep_until(self._anchor_wall + wall_ns)
        return self.now() >= time_ns

    def set_rate(self, rate: float) -> None:
        """Change the rate; it must be above 0."""
        rate = _positive(rate)
        self.jump(self.now())
        self._rate = rate

    def pause(self) -> None:
        """Stop the clock."""
        self.jump(self.now())
        self._paused = True

    def resume(self) -> None:
        """Start a paused clock."""
        self.jump(self.now())
        self._paused = False

    def jump(self, time_ns: int) -> None:
        """Set the time, paused or not."""
        self._anchor, self._anchor_wall = time_ns, self._wall.now()


def _positive(rate: float) -> float:
    if not 0 < rate < float("inf"):
        raise ValueError(f"rate must be positive and finite, not {rate}")
    return rate


class Playback(StrEnum):
    """The state of a player."""

    PLAYING = "playing"
    PAUSED = "paused"
    ENDED = "end"  # paused at the end of the span
    QUIT = "quit"


class Player:
    """Plays a span [ns] of a recording: a state machine over a `PlayerClock`.

    Call `update` before reading `now`, and `press` with the name of each key: "space" pauses and
    resumes, and at the end plays again from the start; "left" and "right" seek 1 s, "home" and
    "end" the ends of the span; "." and "," seek the next and the previous control step, "e" and "E"
    the next and the previous event, and pause; "+" and "-" double and halve the rate, "q" quits.
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
        self._steps, self._events = recording.step_ns, recording.event_ns
        self._loop = loop
        self._quit = False
        self.jumps = 0  # how often the time was set
        self._clock = PlayerClock(wall, at_ns=self.start_ns, rate=rate, paused=paused)

    @property
    def now(self) -> int:
        """Time of the trial [ns], within the span played."""
        return min(self._clock.now(), self.until_ns)

    @property
    def rate(self) -> float:
        """Seconds of the trial per second."""
        return self._clock.rate

    @property
    def state(self) -> Playback:
        """The state of the player."""
        if self._quit:
            return Playback.QUIT
        if not self._clock.paused:
            return Playback.PLAYING
        return Playback.ENDED if self._clock.now() >= self.until_ns else Playback.PAUSED

    def update(self) -> None:
        """At the end of the span, begin again with `loop`, else pause."""
        if self._clock.now() >= self.until_ns and not self._clock.paused:
            if self._loop:
                self._seek(self.start_ns)
            else:
                self._clock.jump(self.until_ns)
                self._clock.pause()

    def command(self, *, playing: bool, rate: float, at_ns: int | None) -> None:
        """Do what other controls ask: play or pause, at a rate, from a time [ns] or from now.

        A rate out of bounds becomes the nearest within, and one that is not a number changes
        nothing.
        """
        if at_ns is not None:
            self._seek(at_ns)
        if not math.isnan(rate):
            self._clock.set_rate(min(max(rate, RATE_MIN), RATE_MAX))
        if playing is self._clock.paused:
            self._toggle()

    def press(self, key: str) -> None:
        """Act on a key; unknown keys are ignored."""
        match key:
            case "space":
                self._toggle()
            case "left":
                self._seek(self.now - SEEK_NS)
            case "right":
                self._seek(self.now + SEEK_NS)
            case "home":
                self._seek(self.start_ns)
            case "end":
                self._pause_at(self.until_ns)
            case ".":
                self._pause_at(self._after(self._steps, self.until_ns))
            case ",":
                self._pause_at(self._before(self._steps, self.start_ns))
            case "e":
                self._pause_at(self._after(self._events, self.now))
            case "E":
                self._pause_at(self._before(self._events, self.now))
            case "+":
                self._clock.set_rate(min(2 * self.rate, max(RATE_MAX, self.rate)))
            case "-":
                self._clock.set_rate(max(self.rate / 2, min(RATE_MIN, self.rate)))
            case "q":
                self._quit = True

    def _toggle(self) -> None:
        if self.state is Playback.ENDED:
            self._seek(self.start_ns)
        if self._clock.paused:
            self._clock.resume()
        else:
            self._clock.pause()

    def _seek(self, time_ns: int) -> None:
        self.jumps += 1
        self._clock.jump(min(max(time_ns, self.start_ns), self.until_ns))

    def _pause_at(self, time_ns: int) -> None:
        self._clock.pause()
        self._seek(time_ns)

    def _after(self, times: Integers, otherwise: int) -> int:
        """Return the first of some times [ns] after now."""
        index = int(np.searchsorted(times, self.now, side="right"))
        return int(times[index]) if index < len(times) else otherwise

    def _before(self, times: Integers, otherwise: int) -> int:
        """Return the last of some times [ns] before now."""
        index = int(np.searchsorted(times, self.now, side="left"))
        return int(times[index - 1]) if index else otherwise


def span(recording: Recording, start_s: float, until_s: float | None) -> tuple[int, int]:
    """Return the times [ns] of the first and last instant to play; UsageError for an empty span.

    `start_s` and `until_s` count from the first direction; the log may begin before it.
    """
    first_s, end_s = recording.elapsed_s(0), recording.elapsed_s(recording.end_ns)
    if not start_s >= first_s:
        begins = f"at {first_s:.4g}" if first_s else "with the first command, at 0"
        raise UsageError(f"--start {start_s:g} lies before the log, which begins {begins}")
    if start_s > end_s:
        raise UsageError(f"--start {start_s:g} lies behind the end: the trial lasts {end_s:g} s")
    if until_s is not None and not start_s < until_s:
        raise UsageError(f"--start {start_s:g} must lie before --until {until_s:g}")
    began_ns = recording.began_ns
    if until_s is None or until_s > end_s:
        return began_ns + round(SECOND * start_s), recording.end_ns
    return began_ns + round(SECOND * start_s), began_ns + round(SECOND * until_s)
