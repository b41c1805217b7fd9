"""Report during a trial how the robots differ from the controller's model of them.

A controller estimates how the robots move (`tetractl.core.motion_estimate`). `ModelMonitor` reads
each estimate and reports, once a trial each: robots that stand although they are driven, motion
that the model does not explain, robots on which commands act late, and values of the spec that the
estimates contradict, such as the lag of the wheels. When the model fits again, it reports what has
changed in the meantime.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from tetractl.core.clock import SECOND
from tetractl.core.elementary import exp, expm1, hypot
from tetractl.core.motion_estimate import LAG_ERROR_S, OF_PLACES, OF_TURNING, Estimate
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.spec.experiment import Experiment
from tetractl.spec.lab_section import LabSection
from tetractl.spec.section_abilities import Accepting

CHANGE_STDS = 3.0
"""Minimum change of an estimate that is reported, in standard deviations."""
FITS_AGAIN_AFTER_S = 5.0
"""Time without a mismatch after which the model counts as fitting again [s]."""
DEAD_TIME_ERROR_S = 0.025
"""Minimum error of the spec's dead time that is reported [s]: the time between two commands at
the 40 Hz of `twist` robots. A robot that misses a command obeys the next one, so lost commands
alone make the estimate differ by up to this time, and no field of the spec is wrong then."""
LATE_ROBOT_S = 0.05
"""Minimum difference between two robots' dead times that is reported [s]. The reason is in
docs/decisions/filter.md."""
LATE_ROBOT_FOR_S = 2.0
"""Time for which that difference must last before it is reported [s]. While the filter starts its
bank of hypotheses again, the dead times differ for a moment."""
DEAD_TIME = "controller.dead_time"
LATENCY = "lab.camera.latency"
HOST_DELAY = "the host's delay (plant.drive.lead, lab.actuator.delay)"
NOISE_UNSTATED = (
    "headings are not as predicted, and the spec does not state the camera's noise: "
    "controller.prior.position_noise, heading_noise"
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
        delays: Fields of the spec that are part of this time, as the user knows them. If the
            estimated time differs, one of them is wrong.
        lacks_noise: True if robots without wheels are seen by a camera whose noise the spec does
            not state.
    """

    dead_time_s: float
    delays: tuple[str, ...] = (DEAD_TIME,)
    lacks_noise: bool = False


def stated_model(experiment: Experiment) -> StatedModel:
    """Collect the parts of a spec that a trial's estimates can contradict."""
    plant = experiment.plant
    control = experiment.controller
    lacks_noise = False
    if isinstance(control, Accepting) and not experiment.setup.on_wheels:
        lacks_noise = control.prior.position_noise == 0 or control.prior.heading_noise == 0
    delays = [DEAD_TIME]
    if isinstance(plant, LabSection) and hasattr(plant.camera, "latency"):
        delays.append(LATENCY)
    if experiment.setup.on_wheels:
        delays.append(HOST_DELAY)
    return StatedModel(control.dead_time, tuple(delays), lacks_noise)


def describe_dead_time_error(estimate: Estimate, stated: StatedModel) -> str:
    """Describe by how much the estimated dead time contradicts the spec.

    Returns:
        The description, or "" if the two agree within DEAD_TIME_ERROR_S and the estimate's
        uncertainty, or if the dead time is not estimated.
    """
    estimated_s = estimate.dead_time
    std_s = estimate.dead_time_std
    if estimated_s is None or std_s is None:
        return ""
    if abs(estimated_s - stated.dead_time_s) <= max(DEAD_TIME_ERROR_S, CHANGE_STDS * std_s):
        return ""
    delays = " or ".join(stated.delays)
    return (
        f"commands act {estimated_s:.3f} s after they are sent, but the spec says "
        f"{stated.dead_time_s:.3f} s: is {delays} wrong?"
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
        f"the wheels follow with a lag of {lag_s:.2f} s, but the spec says {setup.lag_s:.2f} "
        "s: the controller uses the lag that it has found; put it into the spec "
        "(wheels.lag, lab.lag)"
    )


def describe_turning(estimate: Estimate, robot: int) -> str:
    """Describe how a robot's turning differs from a single rate a for both directions.

    The result is empty if it does not differ significantly. `robot` is the robot's index.
    """
    parts = list[str]()
    side = estimate.side
    std = estimate.side_std
    saturation = estimate.saturation
    if side is not None and std is not None and abs(side[robot]) > CHANGE_STDS * std[robot]:
        faster_side = "left" if side[robot] > 0 else "right"
        percent = 100 * expm1(2 * abs(side[robot]))
        parts.append(f"turns {percent:.0f} % faster to the {faster_side}")
    if saturation is not None and side is not None and saturation[robot] < 1:
        max_rate = estimate.a[robot] * exp(abs(side[robot])) * saturation[robot]
        parts.append(f"turns at {max_rate:.2g} rad/s at most")
    return ", ".join(parts)


def differs(
    value: float | None, std: float | None, value_before: float | None, std_before: float | None
) -> bool:
    """Check whether two estimates differ by more than CHANGE_STDS of their difference.

    Args:
        value: The newer estimate; None if it is unknown.
        std: Its standard deviation; None if it is unknown.
        value_before: The older estimate; None if it is unknown.
        std_before: Its standard deviation; None if it is unknown.

    Returns:
        True if they differ, False if they do not or if any of the four is unknown.
    """
    if value is None or std is None or value_before is None or std_before is None:
        return False
    return abs(value - value_before) > CHANGE_STDS * hypot(std, std_before)


def _of_robot(values: Floats | None, robot: int) -> float | None:
    """Return the value of one robot, or None if the quantity is not estimated."""
    return None if values is None else float(values[robot])


def describe_changes(estimate: Estimate, before: Estimate, setup: Setup) -> Iterator[str]:
    """Yield a description of each quantity of an estimate that has changed significantly.

    Args:
        estimate: The newer estimate.
        before: The older estimate.
        setup: The robots, whose names and units the descriptions use.
    """
    time_s = estimate.dead_time
    before_s = before.dead_time
    if differs(time_s, estimate.dead_time_std, before_s, before.dead_time_std):
        yield f"commands act {time_s:.3f} s after they are sent, not {before_s:.3f} s"
    for i, name in enumerate(setup.names):
        if differs(estimate.a[i], estimate.a_std[i], before.a[i], before.a_std[i]):
            yield f"a of {name} is {estimate.a[i]:.3g} rad/s, not {before.a[i]:.3g}"
        if differs(estimate.speed[i], estimate.speed_std[i], before.speed[i], before.speed_std[i]):
            speed = f"{estimate.speed[i]:.3g} {setup.unit}/s"
            yield f"speed of {name} is {speed}, not {before.speed[i]:.3g}"
        lag = _of_robot(estimate.lag, i)
        lag_before = _of_robot(before.lag, i)
        lag_stds = _of_robot(estimate.lag_std, i), _of_robot(before.lag_std, i)
        if differs(lag, lag_stds[0], lag_before, lag_stds[1]):
            yield f"the wheels of {name} follow with a lag of {lag:.2f} s, not {lag_before:.2f} s"
        turning = describe_turning(estimate, i)
        if turning and turning != describe_turning(before, i):
            yield f"{name} {turning}"


@dataclass(slots=True)
class Mismatch:
    """A period in which the model does not explain the robots' turning.

    Attributes:
        before: The estimate when the period began.
        last_seen_ns: Time of the last estimate with an unexplained part [ns].
        parts: The parts that were unexplained so far, such as "heading of red".
    """

    before: Estimate
    last_seen_ns: int
    parts: set[str]


def model_monitor(experiment: Experiment) -> "ModelMonitor":
    """Create the monitor that compares the estimates of a trial with the values in its spec."""
    return ModelMonitor(stated_model(experiment))


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
        self._late_since_ns: dict[str, int] = {}  # by the name of each robot that is late now
        self._mismatch: Mismatch | None = None

    def notices(self, estimate: Estimate, setup: Setup, now_ns: int) -> list[Notice]:
        """Collect the notices that an estimate gives rise to, and remember them as reported.

        Args:
            estimate: The newest estimate.
            setup: The robots.
            now_ns: Time of the estimate [ns].
        """
        notices = list[Notice]()
        for name in estimate.standing(setup.names):
            text = f"{name} stands still although it is sent a direction"
            self._add_once(notices, Notice("info", text))
        for part in sorted(estimate.unexplained(setup.names, OF_PLACES)):
            text = f"{part} is not as predicted, which says nothing of a"
            self._add_once(notices, Notice("info", text))
        lag_error = describe_lag_error(estimate, setup)
        if lag_error:
            self._add_once(notices, Notice("info", lag_error), key="lag")
        for name, text in self._late_robots(estimate, setup, now_ns):
            self._add_once(notices, Notice("warning", text), key=f"late: {name}")
        unexplained = estimate.unexplained(setup.names, OF_TURNING)
        if self._stated is not None and self._stated.lacks_noise:
            if unexplained:
                self._add_once(notices, Notice("warning", NOISE_UNSTATED))
        elif unexplained:
            self._note_mismatch(notices, unexplained, estimate, now_ns)
        else:
            self._note_fit(notices, estimate, setup, now_ns)
        return notices

    def _add_once(self, notices: list[Notice], notice: Notice, key: str = "") -> None:
        """Add a notice, unless one with the same key was added before in this trial.

        The key is the notice's text by default.
        """
        key = key or notice.text
        if key not in self._reported:
            self._reported.add(key)
            notices.append(notice)

    def _late_robots(self, estimate: Estimate, setup: Setup, now_ns: int) -> list[tuple[str, str]]:
        """List the robots that have been later than the quickest one for LATE_ROBOT_FOR_S.

        Returns:
            The name of each such robot, and a description.
        """
        since_ns_before = self._late_since_ns
        self._late_since_ns = {}
        delays_s = estimate.own_dead_time
        stds_s = estimate.own_dead_time_std
        if delays_s is None or stds_s is None:
            return []
        late = list[tuple[str, str]]()
        quickest = int(delays_s.argmin())
        for i, name in enumerate(setup.names):
            difference_s = delays_s[i] - delays_s[quickest]
            significant_s = CHANGE_STDS * hypot(stds_s[i], stds_s[quickest])
            if difference_s <= max(LATE_ROBOT_S, significant_s):
                continue
            self._late_since_ns[name] = since_ns_before.get(name, now_ns)
            if now_ns - self._late_since_ns[name] >= LATE_ROBOT_FOR_S * SECOND:
                text = (
                    f"commands act on {name} about {difference_s:.2f} s later than on "
                    f"{setup.names[quickest]}, or even later: its radio or its wheels are "
                    "slow"
                )
                late.append((name, text))
        return late

    def _note_mismatch(
        self, notices: list[Notice], unexplained: set[str], estimate: Estimate, now_ns: int
    ) -> None:
        """Record that the model does not fit now, and add notices of what is new about that."""
        if self._mismatch is None:
            self._mismatch = Mismatch(estimate, now_ns, set())
        self._mismatch.last_seen_ns = now_ns
        new_parts = unexplained - self._mismatch.parts
        if new_parts:
            self._mismatch.parts |= new_parts
            text = f"the model does not fit: {', '.join(sorted(new_parts))}"
            notices.append(Notice("warning", text))
        if self._stated is not None:
            error = describe_dead_time_error(estimate, self._stated)
            if error:
                self._add_once(notices, Notice("warning", error), key="dead time")

    def _note_fit(
        self, notices: list[Notice], estimate: Estimate, setup: Setup, now_ns: int
    ) -> None:
        """Record that the model fits now.

        Once a mismatch is over, add a notice of what has changed.
        """
        mismatch = self._mismatch
        if mismatch is None or now_ns - mismatch.last_seen_ns < FITS_AGAIN_AFTER_S * SECOND:
            return
        changes = "; ".join(describe_changes(estimate, mismatch.before, setup))
        text = f"the model fits again: {changes or 'with the same values'}"
        notices.append(Notice("info", text))
        self._mismatch = None
