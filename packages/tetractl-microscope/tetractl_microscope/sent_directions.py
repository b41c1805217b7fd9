"""Determines whether robots turned towards the directions in a file, or towards other directions.

The other directions are the mirror image of the directions in the file, or the same numbers in
another unit of angle or time.

A robot turns towards the direction u that acts on it. Its heading h obeys dh/dt = a sin(u - h) or,
if the directions are rotated by f, dh/dt = a sin(u + f - h), which is linear in a cos f and a sin
f:

    dh/dt = a cos f sin(u - h) + a sin f cos(u - h).

This equation is fitted to each robot by least squares. The fraction of the turning that it explains
is near 1 for the directions that acted. It is near 0 for other directions, unless these hardly
change.
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

TIME_STEP_S = 0.05  # time step of the analysis
SMOOTHING_STEPS = 8
"""Number of time steps over which a direction of motion is measured.

They last about as long as a turn of a cell's helix.
"""
GAP_MAX_S = 0.25  # maximum gap between two positions: a longer gap splits a path
PIECE_MIN_S = 2.0  # minimum duration of a piece of a path
STILL_RATE_RAD_S = 0.1  # turning rate that always counts as unexplained [rad/s]
TURNING_STD_MIN_RAD_S = 0.3
"""Minimum standard deviation of the turning rates of robots that count as turning [rad/s]."""
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
"""Maximum number of courses that are used. The longest courses are selected."""
COURSE_DURATION_MAX_S = 120.0
"""Maximum duration of a course that is used [s]. The remainder is cut off."""

DELAY_PLACEHOLDER = "{when}"
"""Placeholder in the message of a reading. The delay of the best fit replaces it."""

FieldAt = Callable[[Floats], NDArray[np.complex128]]
"""Function that returns the field that acts at times [s], as x + iy. It is 0 without a field."""
Response = Callable[[Floats, Floats], tuple[complex, Floats]]
"""Function that fits how a robot turns in a field.

It receives the components of the field across and along the course, shape (K, 2), and the turning
rate, shape (K,) [rad/s]. It returns the fitted factor of the field, and the turning rate that the
fit explains, shape (K,).
"""


@dataclass(frozen=True, slots=True)
class RobotCourse:
    """The heading or direction of motion of a robot over time, in steps of TIME_STEP_S.

    Attributes:
        times: The times [s], shape (K,).
        angles_rad: The unwrapped angles over SMOOTHING_STEPS steps [rad], shape (K,).
    """

    times: Floats
    angles_rad: Floats

    def select(self, rows: Bools | slice) -> "RobotCourse":
        """Return a part of the course, selected by a mask or a slice over its times."""
        return RobotCourse(self.times[rows], self.angles_rad[rows])


@dataclass(frozen=True)  # without slots, for the cached property
class SentDirections:
    """Directions of the field that were sent, in the order of time. Each acts until the next.

    Attributes:
        times: When the directions were sent [s], shape (C,).
        angles: The directions [rad], shape (C,).
        strengths: Strengths of the field, relative to the reference field, shape (C,) or one number
            for all.
    """

    times: Floats
    angles: Floats
    strengths: Floats | float = 1.0

    @cached_property
    def fields(self) -> NDArray[np.complex128]:
        """The field after each direction was sent, as x + iy, shape (C,)."""
        return np.asarray(self.strengths * np.exp(1j * self.angles), dtype=np.complex128)

    def field_at(self, times: Floats) -> NDArray[np.complex128]:
        """Return the field that acts at some times [s], as x + iy.

        The field is 0 before the first direction.
        """
        index = np.searchsorted(self.times, times, side="right") - 1
        return np.where(index < 0, 0.0, self.fields[index])


@dataclass(frozen=True, slots=True)
class DirectionReading:
    """Another interpretation of the directions in a file, such as their mirror image.

    Attributes:
        sent: The directions in this interpretation.
        delays_s: Delays after which they may have acted [s].
        response: Fits how robots turn towards them.
        message: The error message if these directions acted. It may contain DELAY_PLACEHOLDER.
        hint: The hint of this error: what the user should do.
    """

    sent: SentDirections
    delays_s: Floats
    response: Response
    message: str
    hint: str


def compute_courses(paths: Sequence[Floats]) -> list[RobotCourse]:
    """Compute the directions of motion along some paths.

    Each path has rows of time [s], x and y, shape (K, 3). It is split at gaps, and each piece gives
    a course. A course is the direction from each place to the place SMOOTHING_STEPS steps later.
    """
    all_courses: list[RobotCourse] = []
    for path_piece in chain.from_iterable(map(_split_at_gaps, paths)):
        times = np.arange(path_piece[0, 0], path_piece[-1, 0], TIME_STEP_S)
        x, y = (np.interp(times, path_piece[:, 0], path_piece[:, k]) for k in (1, 2))
        positions = x + 1j * y
        directions = np.angle(positions[SMOOTHING_STEPS:] - positions[:-SMOOTHING_STEPS])
        all_courses.append(_create_centred_course(times, np.unwrap(directions)))
    return all_courses


def _create_centred_course(times: Floats, angle: Floats) -> RobotCourse:
    """Create a course in which each angle has the time in the middle of its measurement.

    Each angle [rad] is measured over SMOOTHING_STEPS steps between the times (K,) [s].
    """
    return RobotCourse(times[SMOOTHING_STEPS // 2 : SMOOTHING_STEPS // 2 + len(angle)], angle)


def check_directions(
    source: str,
    robot_courses: Sequence[RobotCourse],
    sent: SentDirections,
    delays_s: Floats,
    readings: Sequence[DirectionReading],
    fraction_min: float = 0.0,
) -> None:
    """Check that robots turned towards the directions in a file as they are stated.

    Another reading of the directions, such as their mirror image, must not explain the turning
    better. Directions that are only rotated are accepted: the angle is the heading bias. If robots
    were seen for less than SEEN_MIN_S, or hardly turned, no error is raised.

    Args:
        source: The file of the directions.
        robot_courses: The courses of the robots.
        sent: The directions.
        delays_s: Delays after which they may act [s].
        readings: The other readings.
        fraction_min: Minimum fraction of the turning that the directions must explain.

    Raises:
        UsageError: If another reading explains the turning, or if the directions explain too
            little.
    """
    longest = _select_longest_courses(robot_courses)
    if not longest:
        return
    fraction, _ = _find_best_delay(longest, sent, delays_s, fit_turning_towards)
    if fraction >= EXPLAINED_FRACTION_MIN:
        return
    measured_readings = list[Reading]()
    for reading in readings:
        fraction, delay_s = _find_best_delay(
            longest, reading.sent, reading.delays_s, reading.response
        )
        delay_text = f"{abs(delay_s):.1f} s {'before' if delay_s < 0 else 'after'}"
        measured_readings.append(
            Reading(fraction, reading.message.replace(DELAY_PLACEHOLDER, delay_text), reading.hint)
        )
    rates = np.concatenate([np.diff(course.angles_rad) / TIME_STEP_S for course in longest])
    is_turning = rates.std() > TURNING_STD_MIN_RAD_S
    fraction, _ = _find_best_delay(longest, sent, delays_s, fit_turning_rotated)
    check_explained(
        source, "turns", fraction, fraction_min if is_turning else 0.0, measured_readings
    )


def _select_longest_courses(robot_courses: Sequence[RobotCourse]) -> list[RobotCourse]:
    """Select the COURSES_MAX longest courses, and cut each to its first COURSE_DURATION_MAX_S.

    The list is empty if robots were seen for less than SEEN_MIN_S in total.
    """
    by_length = sorted(robot_courses, key=lambda course: len(course.times), reverse=True)
    first_part = slice(round(COURSE_DURATION_MAX_S / TIME_STEP_S))
    longest = [course.select(first_part) for course in by_length[:COURSES_MAX]]
    seen_s = sum(len(course.times) for course in longest) * TIME_STEP_S
    return longest if seen_s >= SEEN_MIN_S else []


def create_mirror_reading(
    poses_file: str, source: str, sent: SentDirections, subject: str = "robots"
) -> DirectionReading:
    """Create the reading that the directions in a file are mirrored.

    Args:
        poses_file: The file of the poses.
        source: The file of the directions.
        sent: The directions.
        subject: Who turns by them, for the message.
    """
    return DirectionReading(
        sent=replace(sent, angles=-sent.angles),
        delays_s=DELAYS_S,
        response=fit_turning_rotated,
        message=f"{poses_file}: {subject} turn right when the directions in {source} turn left",
        hint=(
            "is the image mirrored, or does y point down? Reverse y and the headings, or "
            "reverse the directions"
        ),
    )


def create_other_readings(
    source: str, sent: SentDirections, image_period_s: float, subject: str = "robots"
) -> list[DirectionReading]:
    """Create readings that the directions in a file have another unit or another clock.

    The directions may be in degrees, or their times may be on another clock, in another unit, or
    numbers of images.

    Args:
        source: The file of the directions.
        sent: The directions.
        image_period_s: Time between two images [s].
        subject: Who turns by them, for the message.
    """
    degrees = replace(sent, angles=np.radians(sent.angles))
    problem = f"{source}: the motion of {subject} fits the directions only if they are in degrees"
    readings = [
        DirectionReading(
            degrees, DELAYS_S, fit_turning_towards, problem, "rename the column to direction_deg"
        ),
        DirectionReading(
            sent=sent,
            delays_s=SHIFTS_S,
            response=fit_turning_towards,
            message=(
                f"{source}: {subject} turn {DELAY_PLACEHOLDER} the directions that they receive"
            ),
            hint="the times in both files must come from the same clock",
        ),
    ]
    for seconds, unit, hint in (
        (image_period_s, "numbers of pictures", f"multiply the times by {image_period_s:.4g} s"),
        (1e-3, "milliseconds", "rename the column to time_ms"),
        (1e-6, "microseconds", "rename the column to time_us"),
        (1e-9, "nanoseconds", "rename the column to time_ns"),
        (60.0, "minutes", "rename the column to time_min"),
    ):
        in_unit = replace(sent, times=seconds * sent.times)
        problem = (
            f"{source}: the motion of {subject} fits the times of the directions only if "
            f"the times are {unit}"
        )
        readings.append(DirectionReading(in_unit, DELAYS_S, fit_turning_towards, problem, hint))
    return readings


def _find_best_delay(
    robot_courses: Sequence[RobotCourse], sent: SentDirections, delays_s: Floats, response: Response
) -> tuple[float, float]:
    """Find the delay after which directions explain most of the robots' turning.

    Returns:
        The fraction that they explain, and the delay [s].
    """
    best = (-np.inf, 0.0)
    for delay_s in delays_s.tolist():
        field = replace(sent, times=sent.times + delay_s).field_at
        fraction, _ = fit_turning(robot_courses, field, response)
        if fraction > best[0]:
            best = (fraction, delay_s)
    return best


def fit_turning_rotated(basis: Floats, rate: Floats) -> tuple[complex, Floats]:
    """Fit the turning of a robot towards a field that may be rotated, by least squares.

    Args:
        basis: Components of the field across the course and along it, shape (K, 2).
        rate: Turning rate, shape (K,) [rad/s].

    Returns:
        The factor of the field, and the turning rate that it explains, shape (K,).
    """
    coefficients = np.linalg.lstsq(basis, rate, rcond=None)[0]
    return complex(*coefficients), basis @ coefficients


def fit_turning_towards(basis: Floats, rate: Floats) -> tuple[complex, Floats]:
    """Fit the turning rate a >= 0 of a robot that turns towards a field, by least squares.

    Args:
        basis: Components of the field across the course and along it, shape (K, 2).
        rate: Turning rate, shape (K,) [rad/s].

    Returns:
        The rate a, and the turning rate that it explains, shape (K,).
    """
    unit_turning_rates = basis[:, 0]
    squared_sum = float(unit_turning_rates @ unit_turning_rates)
    a = max(0.0, float(rate @ unit_turning_rates) / squared_sum) if squared_sum > 0 else 0.0
    return complex(a), a * unit_turning_rates


def fit_turning(
    robot_courses: Sequence[RobotCourse], field: FieldAt, response: Response = fit_turning_rotated
) -> tuple[float, NDArray[np.complex128]]:
    """Compute how well a field explains the turning of N robots.

    Args:
        robot_courses: The courses of the robots.
        field: The field over time.
        response: Fits how robots turn in the field.

    Returns:
        The fraction of the turning that the field explains, and the field's factor a exp(if) for
        each course, shape (N,) [rad/s].
    """
    total_squares = 0.0
    residual_squares = 0.0
    factors: list[complex] = []
    for course in robot_courses:
        rate = np.gradient(course.angles_rad, TIME_STEP_S)[SMOOTHING_STEPS:-SMOOTHING_STEPS]
        factor, explained_rate = response(_compute_unit_turning_rates(course, field), rate)
        residual = rate - explained_rate
        still_squares = STILL_RATE_RAD_S**2 * len(rate)
        total_squares += float(rate @ rate) + still_squares
        residual_squares += float(residual @ residual) + still_squares
        factors.append(factor)
    return 1 - residual_squares / total_squares, np.array(factors)


def _split_at_gaps(path: Floats) -> list[Floats]:
    """Split a path (K, 3) at gaps above GAP_MAX_S, and leave out pieces up to PIECE_MIN_S."""
    if len(path) < 2:
        return []
    cuts = np.flatnonzero(np.diff(path[:, 0]) > GAP_MAX_S) + 1
    return [
        path_piece for path_piece in np.split(path, cuts) if np.ptp(path_piece[:, 0]) > PIECE_MIN_S
    ]


def _compute_unit_turning_rates(course: RobotCourse, field: FieldAt) -> Floats:
    """Compute the turning rates of a robot with a = 1 in a field, shape (M, 2) [rad/s].

    The columns are the turning rates without a rotation of the field (f = 0), and with a rotation
    by a quarter turn (f = pi / 2).
    """
    # an angle of a course is a mean over these steps, so the field is averaged over them, too
    window = np.ones(SMOOTHING_STEPS) / SMOOTHING_STEPS
    unit_rates = field(course.times) * np.exp(-1j * course.angles_rad)
    mean_rates = np.convolve(unit_rates, window, "same")[SMOOTHING_STEPS:-SMOOTHING_STEPS]
    return np.stack([mean_rates.imag, mean_rates.real], axis=1)
