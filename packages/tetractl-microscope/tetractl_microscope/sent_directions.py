"""Determines whether robots turned by the directions in a file, or by other directions.

Other directions are their mirror image, or the same numbers in another unit of angle or time.

A robot turns towards the direction u that acts. Its heading h obeys dh/dt = a sin(u - h) or, if the
directions are rotated by f, dh/dt = a sin(u + f - h), which is linear in a cos f and a sin f:

    dh/dt = a cos f sin(u - h) + a sin f cos(u - h).

This equation is fitted to each robot by least squares. The fraction of the turning that it explains
is near 1 for the directions that acted. It is near 0 for others, unless these hardly change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats
from tetractl_microscope.one_recording import (
    EXPLAINED_FRACTION_MIN,
    Reading,
    check_explained,
)

GRID_S = 0.05  # time step of the analysis
SMOOTHING_STEPS = (
    8  # steps over which a course is measured: a turn of a cell's helix takes about as long
)
GAP_MAX_S = 0.25  # maximum gap between two positions: a longer gap splits a path
PIECE_MIN_S = 2.0  # minimum duration of a piece of a path
STILL_RATE_RAD_S = 0.1  # turning rate that always counts as unexplained [rad/s]
TURNING_STD_MIN_RAD_S = 0.3
"""Standard deviation of turning rates above which robots count as turning [rad/s]."""
DELAYS_S = np.arange(21) / 10
"""Dead times that are tried [s], up to the longest that `identify` can find."""
SHORT_DELAYS_S = np.arange(3) / 10
"""Dead times that are tried for a field whose dead time is not fitted [s]."""
SHIFTS_S = np.arange(-100, 101) / 10
"""Differences of two clocks that are tried [s]."""
SEEN_MIN_S = 8.0
"""Minimum time for which robots must be seen, added over all robots [s].

Below it, chance explains much of their turning.
"""
COURSES_MAX = 20
"""Maximum number of courses that are used: the longest ones."""
COURSE_S = 120.0
"""Maximum duration of a course that is used [s]. The rest is cut off."""

DELAY_PLACEHOLDER = "{when}"
"""Placeholder in the message of a reading. The delay replaces it."""

FieldAt = Callable[[Floats], NDArray[np.complex128]]
"""Function that returns the direction that acts at times [s] as x + iy, 0 for none."""
Response = Callable[[Floats, Floats], tuple[complex, Floats]]
"""A function that fits a course's turning rate (K,) to the field along it and across it, (K, 2).

It returns the field's factor, and the turning rate that this explains (K,).
"""


@dataclass(frozen=True, slots=True)
class TurnedCourse:
    """The heading or direction of motion of a robot over time, in steps of GRID_S.

    Attributes:
        times: The times [s], shape (K,).
        angle: The angles over SMOOTHING_STEPS steps [rad], shape (K,).
    """

    times: Floats
    angle: Floats

    def at(self, rows: Bools | slice) -> "TurnedCourse":
        """Return the part of the course that `rows`, a mask or a slice over its times, selects."""
        return TurnedCourse(self.times[rows], self.angle[rows])


@dataclass(frozen=True)  # without slots, for the cached property
class SentDirections:
    """Directions that were sent, in the order of time. Each acts until the next one.

    Attributes:
        times: When they were sent [s], shape (C,).
        angles: The directions [rad], shape (C,).
        strengths: Strengths of a field, relative to the reference field.
    """

    times: Floats
    angles: Floats
    strengths: Floats | float = 1.0

    @cached_property
    def acts(self) -> NDArray[np.complex128]:
        """The field from each time of a command until the next one, as x + iy, shape (C,)."""
        return np.asarray(self.strengths * np.exp(1j * self.angles), dtype=np.complex128)

    def at(self, times: Floats) -> NDArray[np.complex128]:
        """Return the field that acts at times [s], as x + iy.

        It is 0 before the first direction.
        """
        index = np.searchsorted(self.times, times, side="right") - 1
        return np.where(index < 0, 0.0, self.acts[index])


@dataclass(frozen=True, slots=True)
class DirectionReading:
    """Directions that may have acted instead of the directions in the file.

    Attributes:
        sent: The directions.
        delays_s: Delays after which they may have acted [s].
        response: How robots turn towards them.
        message: The message if they acted, with the delay.
        hint: What to do then.
    """

    sent: SentDirections
    delays_s: Floats
    response: Response
    message: str
    hint: str


def courses(paths: Sequence[Floats]) -> list[TurnedCourse]:
    """Compute the courses along paths (K, 3) of times [s] and positions x, y.

    A course is the direction from each place to the place SMOOTHING_STEPS steps later.
    """
    all_courses: list[TurnedCourse] = []
    for path_piece in chain.from_iterable(map(_split_at_gaps, paths)):
        times = np.arange(path_piece[0, 0], path_piece[-1, 0], GRID_S)
        x, y = (np.interp(times, path_piece[:, 0], path_piece[:, k]) for k in (1, 2))
        positions = x + 1j * y
        directions = np.angle(positions[SMOOTHING_STEPS:] - positions[:-SMOOTHING_STEPS])
        all_courses.append(_centred_course(times, np.unwrap(directions)))
    return all_courses


def _centred_course(times: Floats, angle: Floats) -> TurnedCourse:
    """Create a course from angles, each measured over SMOOTHING_STEPS steps between times (K,) [s].

    Each angle gets the time in the middle of its steps.
    """
    return TurnedCourse(times[SMOOTHING_STEPS // 2 : SMOOTHING_STEPS // 2 + len(angle)], angle)


def check_directions(
    source: str,
    turned: Sequence[TurnedCourse],
    sent: SentDirections,
    delays_s: Floats,
    readings: Sequence[DirectionReading],
    fraction_min: float = 0.0,
) -> None:
    """Check that robots turn by the stated directions, and not by another reading of them.

    Directions that are only rotated are accepted: the angle is the heading bias. If robots were
    seen for less than SEEN_MIN_S, or hardly turn, nothing is known and nothing is raised.

    Args:
        source: The file of the directions.
        turned: The courses of the robots.
        sent: The directions.
        delays_s: Delays after which they may act [s].
        readings: The other readings.
        fraction_min: Minimum fraction of the turning that the directions must explain.

    Raises:
        UsageError: If another reading explains the turning, or if the directions explain too
            little.
    """
    longest = _longest_courses(turned)
    if not longest:
        return
    fraction, _ = _best_delay(longest, sent, delays_s, towards)
    if fraction >= EXPLAINED_FRACTION_MIN:
        return
    readings_tried = list[Reading]()
    for reading in readings:
        fraction, delay_s = _best_delay(longest, reading.sent, reading.delays_s, reading.response)
        delay_text = f"{abs(delay_s):.1f} s {'before' if delay_s < 0 else 'after'}"
        readings_tried.append(
            Reading(fraction, reading.message.replace(DELAY_PLACEHOLDER, delay_text), reading.hint)
        )
    rates = np.concatenate([np.diff(course.angle) / GRID_S for course in longest])
    is_turning = rates.std() > TURNING_STD_MIN_RAD_S
    fraction, _ = _best_delay(longest, sent, delays_s, rotated)
    check_explained(source, "turns", fraction, fraction_min if is_turning else 0.0, readings_tried)


def _longest_courses(turned: Sequence[TurnedCourse]) -> list[TurnedCourse]:
    """Select the COURSES_MAX longest courses, each cut to its first COURSE_S.

    Empty if robots were seen for less than SEEN_MIN_S in total.
    """
    by_length = sorted(turned, key=lambda course: len(course.times), reverse=True)
    first_part = slice(round(COURSE_S / GRID_S))
    longest = [course.at(first_part) for course in by_length[:COURSES_MAX]]
    seen_s = sum(len(course.times) for course in longest) * GRID_S
    return longest if seen_s >= SEEN_MIN_S else []


def mirror_reading(
    poses_file: str, source: str, sent: SentDirections, who: str = "robots"
) -> DirectionReading:
    """Return the mirror image of the directions in a file.

    Args:
        poses_file: The file of the poses.
        source: The file of the directions.
        sent: The directions.
        who: Who turns by them, for the message.
    """
    return DirectionReading(
        sent=replace(sent, angles=-sent.angles),
        delays_s=DELAYS_S,
        response=rotated,
        message=f"{poses_file}: {who} turn right when the directions in {source} turn left",
        hint=(
            "is the image mirrored, or does y point down? Reverse y and the headings, or "
            "reverse the directions"
        ),
    )


def other_readings(
    source: str, sent: SentDirections, picture_s: float, who: str = "robots"
) -> list[DirectionReading]:
    """Return other readings of the directions in a file.

    They may be in degrees, on another clock, in another unit of time, or their times may count
    images.

    Args:
        source: The file of the directions.
        sent: The directions.
        picture_s: Time between two images [s].
        who: Who turns by them, for the message.
    """
    degrees = replace(sent, angles=np.radians(sent.angles))
    problem = f"{source}: the motion of {who} fits the directions only if they are in degrees"
    readings = [
        DirectionReading(degrees, DELAYS_S, towards, problem, "rename the column to direction_deg"),
        DirectionReading(
            sent=sent,
            delays_s=SHIFTS_S,
            response=towards,
            message=f"{source}: {who} turn {DELAY_PLACEHOLDER} the directions that they receive",
            hint="the times in both files must come from the same clock",
        ),
    ]
    for seconds, unit, hint in (
        (picture_s, "numbers of pictures", f"multiply the times by {picture_s:.4g} s"),
        (1e-3, "milliseconds", "rename the column to time_ms"),
        (1e-6, "microseconds", "rename the column to time_us"),
        (1e-9, "nanoseconds", "rename the column to time_ns"),
        (60.0, "minutes", "rename the column to time_min"),
    ):
        in_unit = replace(sent, times=seconds * sent.times)
        problem = (
            f"{source}: the motion of {who} fits the times of the directions only if "
            f"the times are {unit}"
        )
        readings.append(DirectionReading(in_unit, DELAYS_S, towards, problem, hint))
    return readings


def _best_delay(
    turned: Sequence[TurnedCourse], sent: SentDirections, delays_s: Floats, response: Response
) -> tuple[float, float]:
    """Find the delay after which directions explain the most turning.

    Returns:
        The fraction that they explain, and the delay [s].
    """
    best = (-np.inf, 0.0)
    for delay_s in delays_s.tolist():
        field = replace(sent, times=sent.times + delay_s).at
        fraction, _ = turning_fit(turned, field, response)
        if fraction > best[0]:
            best = (fraction, delay_s)
    return best


def rotated(basis: Floats, rate: Floats) -> tuple[complex, Floats]:
    """Fit the turning to a field that may be rotated, by least squares.

    Args:
        basis: The field along the course and across it, shape (K, 2).
        rate: Turning rate, shape (K,) [rad/s].

    Returns:
        The factor of the field, and the turning rate that it explains, shape (K,).
    """
    fitted = np.linalg.lstsq(basis, rate, rcond=None)[0]
    return complex(*fitted), basis @ fitted


def towards(basis: Floats, rate: Floats) -> tuple[complex, Floats]:
    """Fit the rate a >= 0 at which a robot turns towards the field, by least squares.

    Args:
        basis: The field along the course and across it, shape (K, 2).
        rate: Turning rate, shape (K,) [rad/s].

    Returns:
        The rate a, and the turning rate that it explains, shape (K,).
    """
    unit_rates = basis[:, 0]
    squared_sum = float(unit_rates @ unit_rates)
    a = max(0.0, float(rate @ unit_rates) / squared_sum) if squared_sum > 0 else 0.0
    return complex(a), a * unit_rates


def turning_fit(
    turned: Sequence[TurnedCourse], field: FieldAt, response: Response = rotated
) -> tuple[float, NDArray[np.complex128]]:
    """Compute how well a field explains the turning of N courses.

    Args:
        turned: The courses.
        field: The field.
        response: How robots turn in it.

    Returns:
        The fraction of the turning that it explains, and the field's factor a exp(if) for each
        course (N,) [rad/s].
    """
    total_squares = 0.0
    residual_squares = 0.0
    factors: list[complex] = []
    for course in turned:
        rate = np.gradient(course.angle, GRID_S)[SMOOTHING_STEPS:-SMOOTHING_STEPS]
        factor, explained_rate = response(_unit_turning_rates(course, field), rate)
        residual = rate - explained_rate
        floor = STILL_RATE_RAD_S**2 * len(rate)
        total_squares += float(rate @ rate) + floor
        residual_squares += float(residual @ residual) + floor
        factors.append(factor)
    return 1 - residual_squares / total_squares, np.array(factors)


def _split_at_gaps(path: Floats) -> list[Floats]:
    """Split a path (K, 3) at gaps above GAP_MAX_S.

    The pieces that last longer than PIECE_MIN_S are returned in their order.
    """
    if len(path) < 2:
        return []
    cuts = np.flatnonzero(np.diff(path[:, 0]) > GAP_MAX_S) + 1
    return [
        path_piece for path_piece in np.split(path, cuts) if np.ptp(path_piece[:, 0]) > PIECE_MIN_S
    ]


def _unit_turning_rates(course: TurnedCourse, field: FieldAt) -> Floats:
    """Compute the turning rates that a = 1 gives with f = 0 and with f = pi / 2, shape (M, 2)."""
    window = (
        np.ones(SMOOTHING_STEPS) / SMOOTHING_STEPS
    )  # a course is a mean, and so is what turns it
    unit_rates = field(course.times) * np.exp(-1j * course.angle)
    mean_rates = np.convolve(unit_rates, window, "same")[SMOOTHING_STEPS:-SMOOTHING_STEPS]
    return np.stack([mean_rates.imag, mean_rates.real], axis=1)
