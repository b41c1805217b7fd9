"""When the pictures of a film were taken: one answer for every source.

A film states the times of its pictures in tags (OME, Micro-Manager, ND2), by the clock of its
container, or by the numbers in the names of its files; the user states them in `times.csv`. Without
any, picture k is taken at k / rate. Times are in seconds from the first picture, except those of
`times.csv`, which are on the clock of the field's file.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

EVEN = 1e-3  # deviation from an even rate that is rounding [pictures]
CLOCK_S = 1e-3  # step of the coarsest clock of a container, Matroska's [s]
UNEVEN = 1.1  # ratio of the longest to the shortest time between pictures that is said
PAUSE = 3.0  # ratio of the longest to the usual time between pictures that is a pause
BACKWARDS_MOST = 0.1  # share of times before an earlier picture's above which none is accepted


@dataclass(slots=True)
class PictureTimes:
    """The times of a film's pictures: `stated` [s], or number / `nominal_hz` if that is None.

    The clock of a container is known only as far as its pictures are read: `note` adds to `stated`.
    """

    nominal_hz: float
    stated: list[float] | None = None
    source: str = "the film"  # what states the times
    doubted: int = 0  # number of times that were not accepted
    even: bool = field(init=False)  # whether the pictures known so far are at number / nominal_hz

    def __post_init__(self) -> None:
        self.even = all(self._is_even(k, time) for k, time in enumerate(self.stated or ()))

    def _is_even(self, number: int, seconds: float) -> bool:
        return abs(seconds * self.nominal_hz - number) < EVEN

    def seconds(self, number: int) -> float:
        """Return the time of a picture [s]."""
        return number / self.nominal_hz if self.stated is None else self.stated[number]

    @property
    def rate_hz(self) -> float:
        """The mean rate of the pictures known so far [Hz]."""
        if self.even or self.stated is None:
            return self.nominal_hz
        return mean_rate_hz(self.stated)

    def duration(self, first: int, last: int) -> float:
        """Return the time from a first to a last picture, with the period of the last one [s]."""
        if self.even:
            return (last - first + 1) / self.nominal_hz
        return self.seconds(last) - self.seconds(first) + 1 / self.rate_hz

    def note(self, number: int, seconds: float) -> None:
        """Enter what a container's clock says of the next picture, from the first one on [s].

        A time within the clock's step of an even rate is rounded, and taken as even. One that is
        not after the time before is `doubted`: the picture is taken as a period later.
        """
        assert self.stated is not None
        if number < len(self.stated):  # it is decoded again
            return
        if abs(seconds - number / self.nominal_hz) < min(CLOCK_S, 0.5 / self.nominal_hz):
            seconds = number / self.nominal_hz
        if self.stated and seconds <= self.stated[-1]:
            seconds = self.stated[-1] + 1 / self.nominal_hz
            self.doubted += 1
        self.even = self.even and self._is_even(number, seconds)
        self.stated.append(seconds)

    def uneven_line(self) -> str | None:
        """Return how uneven the pictures known so far are, None if hardly."""
        if self.stated is None or len(self.stated) < 2 or self.even:
            return None
        gaps = np.diff(self.stated)
        least = float(gaps.min())
        most = float(gaps.max())
        if most < UNEVEN * least:
            return None
        line = f"pictures are {least:.3g} to {most:.3g} s apart"
        if most > PAUSE * float(np.median(gaps)):
            line += f", with a pause at {self.stated[int(gaps.argmax())]:.3g} s"
        if self.doubted:
            line += f"; {self.doubted} have no later time than the one before, and are guessed"
        return line


def mean_rate_hz(times: Sequence[float]) -> float:
    """Return the mean rate of pictures at two or more times [Hz]."""
    return (len(times) - 1) / (times[-1] - times[0])


def increasing(stated: Sequence[float | None]) -> tuple[list[float] | None, list[str]]:
    """Return the times of all pictures [s] from the first on, by those that are stated, and lines
    on what was dropped; no times if those that are stated cannot be right.

    Times that are missing, repeated, or before an earlier picture's are interpolated between their
    neighbours; of repeated ones the first is kept, as a coarse clock shows it. No times remain if
    fewer than two differ, or more than BACKWARDS_MOST are before an earlier picture's.
    """
    numbers = [number for number, time in enumerate(stated) if _is_time(time)]
    times = [float(time) for time in stated if time is not None and _is_time(time)]
    if not times:
        return None, []
    if len(set(times)) < 2:
        said = "state no time but the first" if len(times) < 2 else "all state the same time"
        return None, [f"its pictures {said}, which is not used"] if len(stated) > 1 else []
    latest = np.maximum.accumulate([-math.inf, *times[:-1]])  # before each
    rising = np.flatnonzero(np.greater(times, latest)).tolist()
    missing = len(stated) - len(times)
    repeated = int(np.count_nonzero(np.equal(times, latest)))
    backwards = len(times) - len(rising) - repeated
    if backwards > BACKWARDS_MOST * len(times):
        return None, [
            f"warning: {backwards} of {len(times)} times of its pictures are not in order, so that "
            "none is used"
        ]
    lines = []
    for count, what in (
        (missing, "no time"),
        (repeated, "the time of the picture before"),
        (backwards, "a time that is not in order"),
    ):
        if count:
            state = "picture states" if count == 1 else "pictures state"
            lines.append(f"warning: {count} {state} {what}; times between the others are taken")
    seconds = _interpolated([numbers[k] for k in rising], [times[k] for k in rising], len(stated))
    return [time - seconds[0] for time in seconds], lines


def _is_time(time: float | None) -> bool:
    return time is not None and math.isfinite(time)


def _interpolated(numbers: Sequence[int], times: Sequence[float], count: int) -> list[float]:
    """Return the times of `count` pictures, of which some numbers' are known; beyond these by the
    median interval.
    """
    steps = np.diff(times) / np.diff(numbers)
    step = float(np.median(steps))
    seconds = np.interp(np.arange(count), numbers, times)
    head = numbers[0]
    tail = numbers[-1]
    seconds[:head] = times[0] - step * np.arange(head, 0, -1)
    seconds[tail + 1 :] = times[-1] + step * np.arange(1, count - tail)
    return seconds.tolist()
