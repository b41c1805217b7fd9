"""Report during a trial how the robots differ from the controller's model of them.

A controller estimates how the robots move (`tetractl.core.motion_estimate`). `ModelMonitor` reads
each estimate and reports, once a trial each: robots that stand although they are driven, motion
that the model does not explain, robots on which commands act late, and values of the spec that the
estimates contradict, such as the lag of the wheels. Each message describes what was observed. None
names a cause, because the same motion can have several. Lags and late robots are reported only if
the model has fitted for a while, because otherwise they may be the best values of a wrong model.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from typing import Literal, NamedTuple

from tetractl.core.clock import SECOND
from tetractl.core.elementary import exp, expm1, hypot
from tetractl.core.motion_estimate import (
    INNOVATIONS,
    LAG_ERROR_S,
    POSITION_INNOVATIONS,
    TURNING_INNOVATIONS,
    Estimate,
    PredictionErrors,
)
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.spec.experiment import Experiment
from tetractl.spec.lab_section import LabSection
from tetractl.spec.section_abilities import Accepting

CHANGE_STDS = 3.0
"""Minimum difference of an estimate from the spec that is reported, in standard deviations."""
FITS_AGAIN_AFTER_S = 5.0
"""Time without a mismatch after which the model counts as fitting again [s]."""
DEAD_TIME_ERROR_MIN_S = 0.025
"""Minimum error of the spec's dead time that is reported [s]: the time between two commands at
the 40 Hz of `twist` robots. A robot that misses a command obeys the next one, so lost commands
alone make the estimate differ by up to this time, and no field of the spec is wrong then."""
LATE_ROBOT_MIN_S = 0.05
"""Minimum difference between two robots' dead times that is reported [s]. The reason is in
docs/decisions/filter.md."""
LATE_ROBOT_DURATION_S = 2.0
"""Time for which LATE_ROBOT_MIN_S must be exceeded before a late robot is reported [s].

While the filter restarts its bank of hypotheses, the dead times differ for a moment.
"""
STANDING_TIME_MIN_S = 0.15
"""Minimum time for which a robot must stand still before it is reported [s]."""
STANDING_FRACTION_MAX = 0.1
"""Maximum distance that a standing robot moves in this time; chosen.

The value is a fraction of the distance that the robot would drive.
"""
ONE_SIDED_MEAN_MIN = 0.5
"""Minimum mean of deviations for which the message names one direction; chosen.

The value is a fraction of the deviations' root mean square.
"""
DEVIATION_DIRECTIONS = {
    "along-track motion": ("ahead", "behind"),
    "cross-track motion": ("to the left", "to the right"),
    "heading": ("to the left", "to the right"),
}
"""The directions of a positive and of a negative deviation, for each of INNOVATIONS."""
DEAD_TIME_FIELD = "controller.dead_time"
"""Field of the spec that states the dead time."""
LATENCY_FIELD = "lab.camera.latency"
"""Field of the spec that states the latency of a lab's camera."""
HOST_DELAY_FIELDS = "the host's delay (plant.drive.lead, lab.actuator.delay)"
"""Fields of the spec that state the delay in the host of robots on wheels, as a user knows them."""
NOISE_UNSTATED = (
    "headings are not as predicted, perhaps because the spec does not state the camera's noise: "
    "set controller.prior.position_noise and heading_noise"
)
"""The warning if the headings of cells do not fit and the spec does not state the camera's noise.
In three specs that did not state it, the interval of the turning rate was right for 40 of 43 such
robots. With the noise stated, it was right for all of them (docs/decisions/filter.md)."""


class Notice(NamedTuple):
    """A message about how the robots differ from their model.

    Attributes:
        level: Its level in the log.
        text: The message.
    """

    level: Literal["info", "warning"]
    text: str


@dataclass(frozen=True, slots=True)
class StatedModel:
    """The parts of a spec that a trial's estimates can contradict.

    Attributes:
        dead_time_s: Time from sending a command until it acts [s].
        delay_fields: Fields of the spec that are part of this time, as the user knows them. If the
            estimated time differs, one of them is wrong.
        lacks_noise: True if robots without wheels are seen by a camera whose noise the spec does
            not state.
    """

    dead_time_s: float
    delay_fields: tuple[str, ...] = (DEAD_TIME_FIELD,)
    lacks_noise: bool = False


def stated_model(experiment: Experiment) -> StatedModel:
    """Collect the parts of a spec that a trial's estimates can contradict."""
    plant = experiment.plant
    control = experiment.controller
    lacks_noise = False
    if isinstance(control, Accepting) and not experiment.setup.on_wheels:
        lacks_noise = control.prior.position_noise == 0 or control.prior.heading_noise == 0
    delays = [DEAD_TIME_FIELD]
    if isinstance(plant, LabSection) and hasattr(plant.camera, "latency"):
        delays.append(LATENCY_FIELD)
    if experiment.setup.on_wheels:
        delays.append(HOST_DELAY_FIELDS)
    return StatedModel(control.dead_time, tuple(delays), lacks_noise)


def describe_dead_time_error(estimate: Estimate, stated: StatedModel) -> str:
    """Describe by how much the estimated dead time contradicts the spec.

    Returns:
        The description, or "" if the two agree within DEAD_TIME_ERROR_MIN_S and the estimate's
        uncertainty, or if the dead time is not estimated.
    """
    estimated_s = estimate.dead_time
    std_s = estimate.dead_time_std
    if estimated_s is None or std_s is None:
        return ""
    if abs(estimated_s - stated.dead_time_s) <= max(DEAD_TIME_ERROR_MIN_S, CHANGE_STDS * std_s):
        return ""
    delays = " or ".join(stated.delay_fields)
    order = "later" if estimated_s > stated.dead_time_s else "earlier"
    return (
        f"the spec says that commands act {stated.dead_time_s:.3f} s after they are sent, but they "
        f"act {order}: check {delays}. The controller estimates {estimated_s:.3f} s, but this is "
        "uncertain while its model does not fit"
    )


def describe_lag_error(estimate: Estimate, setup: Setup) -> str:
    """Describe by how much the estimated lag of the wheels contradicts the spec.

    Returns:
        The description, or "" if the two agree within LAG_ERROR_S and the uncertainty of each
        robot's estimate, or if the lag is not estimated.
    """
    lag_s = estimate.common_lag
    if lag_s is None or estimate.lag is None or estimate.lag_std is None:
        return ""
    errors_s = abs(estimate.lag - setup.lag_s)
    if (errors_s <= max(LAG_ERROR_S, CHANGE_STDS * float(estimate.lag_std.max()))).any():
        return ""
    return (
        f"the wheels follow their commands with a lag of {lag_s:.2f} s, but the spec says "
        f"{setup.lag_s:.2f} s: the controller already uses the measured lag; put this value into "
        "the spec as well (wheels.lag or lab.lag)"
    )


def describe_turning(estimate: Estimate, robot: int) -> str:
    """Describe how a robot's turning differs from a single rate a for both directions.

    The result is empty if it does not differ significantly. `robot` is the robot's index.
    """
    descriptions = list[str]()
    side = estimate.side
    std = estimate.side_std
    saturation = estimate.saturation
    if side is not None and std is not None and abs(side[robot]) > CHANGE_STDS * std[robot]:
        faster_side = "left" if side[robot] > 0 else "right"
        percent = 100 * expm1(2 * abs(side[robot]))
        descriptions.append(f"turns {percent:.0f} % faster to the {faster_side}")
    if saturation is not None and side is not None and saturation[robot] < 1:
        max_rate = estimate.a[robot] * exp(abs(side[robot])) * saturation[robot]
        descriptions.append(f"never turns faster than {max_rate:.2g} rad/s")
    return ", ".join(descriptions)


def describe_deviation(errors: PredictionErrors, part: str, robot: int, unit: str) -> str:
    """Describe how far and in which direction a robot deviates from its prediction.

    Args:
        errors: The deviations of all robots.
        part: The part of the motion, one of INNOVATIONS.
        robot: Index of the robot.
        unit: The spec's length unit.
    """
    column = INNOVATIONS.index(part)
    late_s = errors.late_s[robot]
    extra_turn = errors.extra_turn[robot]
    if part in TURNING_INNOVATIONS and not isnan(late_s):
        order = "later" if late_s > 0 else "earlier"
        return f"turns about {abs(late_s):.2f} s {order} than predicted"
    if part in TURNING_INNOVATIONS and not isnan(extra_turn):
        order = "more" if extra_turn > 0 else "less"
        return f"turns about {100 * abs(extra_turn):.0f} % {order} than predicted"
    mean = errors.mean[robot, column]
    rms = errors.rms[robot, column]
    directions = DEVIATION_DIRECTIONS[part]
    if abs(mean) < ONE_SIDED_MEAN_MIN * rms:
        direction = " or ".join(directions)
    else:
        direction = directions[0] if mean > 0 else directions[1]
    size = f"{rms:.2f} rad" if part in TURNING_INNOVATIONS else f"{rms:.2g} {unit}"
    return f"after {errors.ahead_s:g} s, about {size} {direction}"


def describe_unexplained(estimate: Estimate, setup: Setup, parts: Sequence[str]) -> dict[str, str]:
    """List the parts of the motion that the model fails to explain, with their deviations.

    Args:
        estimate: The estimate.
        setup: The robots.
        parts: The parts to consider: TURNING_INNOVATIONS or POSITION_INNOVATIONS.

    Returns:
        A description of the deviation in brackets for each part, such as "heading of red". It is
        empty if the deviation is not known yet.
    """
    unexplained = estimate.list_unexplained(setup.names, parts)
    errors = estimate.predictions
    descriptions: dict[str, str] = {}
    for part in parts:
        for i, name in enumerate(setup.names):
            label = f"{part} of {name}"
            if label not in unexplained:
                continue
            descriptions[label] = ""
            if errors is not None:
                deviation = describe_deviation(errors, part, i, setup.unit)
                descriptions[label] = f" ({deviation})"
    return descriptions


@dataclass(slots=True)
class Mismatch:
    """A period in which the model does not explain the robots' turning.

    Attributes:
        last_seen_ns: Time of the last estimate with an unexplained part [ns].
        unexplained_parts: The parts that were unexplained so far, such as "heading of red".
    """

    last_seen_ns: int
    unexplained_parts: set[str]


def model_monitor(experiment: Experiment) -> "ModelMonitor":
    """Create the monitor that compares the estimates of a trial with the values in its spec."""
    return ModelMonitor(stated_model(experiment))


@dataclass(frozen=True, slots=True)
class StandingRobot:
    """A robot that seems to stand still.

    Attributes:
        since_ns: Time since which the robot has stood [ns].
        xy: Position of the robot at that time, shape (2,) [length unit].
    """

    since_ns: int
    xy: Floats


class ModelMonitor:
    """Watches a controller's estimates, and reports how the robots differ from the model.

    Each notice is given once a trial. Only a mismatch of the turning is reported again, if the
    model has fitted for FITS_AGAIN_AFTER_S in between.

    Args:
        stated: The parts of the spec that the estimates can contradict. None if contradictions are
            not to be reported.
    """

    def __init__(self, stated: StatedModel | None = None) -> None:
        self._stated = stated
        self._reported: set[str] = set()
        self._late_since_ns_by_name: dict[
            str, int
        ] = {}  # by the name of each robot that is late now
        self._standing_robots_by_name: dict[
            str, StandingRobot
        ] = {}  # by the name of each robot that seems to stand
        self._mismatch: Mismatch | None = None
        self._first_estimate_ns: int | None = None  # when the first estimate was made
        self._last_mismatch_ns = 0  # when the model did not fit last

    def notices(
        self, estimate: Estimate, setup: Setup, now_ns: int, frame: Observation
    ) -> list[Notice]:
        """Collect the notices that an estimate gives rise to, and remember them as reported.

        Args:
            estimate: The newest estimate.
            setup: The robots.
            now_ns: Time of the estimate [ns].
            frame: The newest camera frame.
        """
        notices = list[Notice]()
        for name in self._standing_robots(estimate, setup, frame):
            text = f"{name} stands still although it is sent a direction"
            self._add_once(notices, Notice("info", text))
        for part, deviation in describe_unexplained(estimate, setup, POSITION_INNOVATIONS).items():
            notice = Notice("info", f"{part} is not as predicted{deviation}")
            self._add_once(notices, notice, key=part)
        unexplained = describe_unexplained(estimate, setup, TURNING_INNOVATIONS)
        if self._stated is not None and self._stated.lacks_noise:
            if unexplained:
                self._add_once(notices, Notice("warning", NOISE_UNSTATED))
        elif unexplained:
            self._note_mismatch(notices, unexplained, estimate, now_ns)
        else:
            self._note_fit(notices, now_ns)
        late_robots = self._late_robots(estimate, setup, now_ns)
        lag_error = describe_lag_error(estimate, setup)
        if self._has_sound_values(estimate, now_ns):
            if lag_error:
                self._add_once(notices, Notice("info", lag_error), key="lag")
            for name, text in late_robots:
                self._add_once(notices, Notice("warning", text), key=f"late: {name}")
        return notices

    def _has_sound_values(self, estimate: Estimate, now_ns: int) -> bool:
        """Check whether the model has fitted long enough for its values to be reported.

        The model must have fitted for the last FITS_AGAIN_AFTER_S. It must also have fitted before,
        except during the first FITS_AGAIN_AFTER_S, while the filters learn.
        """
        enough_ns = FITS_AGAIN_AFTER_S * SECOND
        if self._first_estimate_ns is None:
            self._first_estimate_ns = self._last_mismatch_ns = now_ns
        if not estimate.fits:
            self._last_mismatch_ns = now_ns
        fits_long_enough = now_ns - self._last_mismatch_ns >= enough_ns
        return fits_long_enough and self._last_mismatch_ns - self._first_estimate_ns <= enough_ns

    def _add_once(self, notices: list[Notice], notice: Notice, key: str = "") -> None:
        """Add a notice, unless one with the same key was added before in this trial.

        The key is the notice's text by default.
        """
        key = key or notice.text
        if key not in self._reported:
            self._reported.add(key)
            notices.append(notice)

    def _standing_robots(
        self, estimate: Estimate, setup: Setup, frame: Observation
    ) -> Iterator[str]:
        """Yield the robots that stand still, according to both the filters and the camera frames.

        The filters alone do not suffice: if their model is wrong, the likeliest of their hypotheses
        may be that a robot stands still although it drives.
        """
        previous_by_name = self._standing_robots_by_name
        self._standing_robots_by_name = {}
        filter_names = estimate.list_standing(setup.names)
        for i, name in enumerate(setup.names):
            if name not in filter_names or not frame.valid[i]:
                continue
            xy = frame.poses.xy[i]
            standing = previous_by_name.get(name, StandingRobot(frame.sampled_ns, xy))
            self._standing_robots_by_name[name] = standing
            standing_s = (frame.sampled_ns - standing.since_ns) / SECOND
            distance_max = STANDING_FRACTION_MAX * setup.speed[i] * standing_s
            if standing_s >= STANDING_TIME_MIN_S and hypot(*(xy - standing.xy)) <= distance_max:
                yield name

    def _late_robots(self, estimate: Estimate, setup: Setup, now_ns: int) -> list[tuple[str, str]]:
        """List the robots that have been later than the quickest one for LATE_ROBOT_DURATION_S.

        Returns:
            The name of each such robot, and a description.
        """
        previous_since_ns = self._late_since_ns_by_name
        self._late_since_ns_by_name = {}
        delays_s = estimate.own_dead_time
        stds_s = estimate.own_dead_time_std
        if delays_s is None or stds_s is None:
            return []
        late_robots = list[tuple[str, str]]()
        quickest = int(delays_s.argmin())
        for i, name in enumerate(setup.names):
            difference_s = delays_s[i] - delays_s[quickest]
            significant_s = CHANGE_STDS * hypot(stds_s[i], stds_s[quickest])
            if difference_s <= max(LATE_ROBOT_MIN_S, significant_s):
                continue
            self._late_since_ns_by_name[name] = previous_since_ns.get(name, now_ns)
            if now_ns - self._late_since_ns_by_name[name] >= LATE_ROBOT_DURATION_S * SECOND:
                text = (
                    f"commands act on {name} at least about {difference_s:.2f} s later than on "
                    f"{setup.names[quickest]}"
                )
                late_robots.append((name, text))
        return late_robots

    def _note_mismatch(
        self,
        notices: list[Notice],
        unexplained: Mapping[str, str],
        estimate: Estimate,
        now_ns: int,
    ) -> None:
        """Record that the model does not fit, and add notices about newly unexplained parts."""
        if self._mismatch is None:
            self._mismatch = Mismatch(now_ns, set())
        self._mismatch.last_seen_ns = now_ns
        new_parts = unexplained.keys() - self._mismatch.unexplained_parts
        if new_parts:
            self._mismatch.unexplained_parts |= new_parts
            parts = ", ".join(part + unexplained[part] for part in sorted(new_parts))
            notices.append(Notice("warning", f"the model does not fit: {parts}"))
        if self._stated is not None:
            error = describe_dead_time_error(estimate, self._stated)
            if error:
                self._add_once(notices, Notice("warning", error), key="dead time")

    def _note_fit(self, notices: list[Notice], now_ns: int) -> None:
        """Record that the model fits now, and add a notice once a mismatch is over."""
        mismatch = self._mismatch
        if mismatch is None or now_ns - mismatch.last_seen_ns < FITS_AGAIN_AFTER_S * SECOND:
            return
        notices.append(Notice("info", "the model fits again"))
        self._mismatch = None
