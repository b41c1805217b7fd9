"""What a trial says of the robots: whether the controller's model fits them, and which of them move
while all should stand.

`ModelNews`: that the model does not fit, what was learnt since, and who stands.

`RestNews`: robots that were stopped may move all the same: a motor creeps, or the floor slopes. A
controller that rests to measure them measures where they are no longer, and rests again. In a lab
the guard looks at this, too; here it is for every plant. Of the last LOOK_S of a rest, the mean
place in the first half is compared with that in the second.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Stop
from tetractl.core.motion_estimate import OF_PLACES, OF_TURNING, Estimate
from tetractl.core.plan import Plan
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab_section import LabSection
from tetractl.experiment.section_abilities import Accepting

FITS_S = 5.0  # time without a misfit after which the model fits again [s]
SURE_STDS = 3.0  # least change of an estimate that is news, in standard deviations
DELAY_S = 0.025
"""Least error of a stated dead time that is news [s]: chosen, so that the emulated lab of the
shipped spec, where 0.040 s is estimated and 0.060 s stated, is mostly silent."""
LATER_S = 0.05
"""Least difference of two robots' dead times that is news [s]: docs/decisions/filter.md."""
LATER_FOR_S = 2.0
"""Time for which it has lasted then [s]: while a bank is opened again, dead times differ."""
DEAD_TIME = "controller.dead_time"
LATENCY = "lab.camera.latency"
HOST_DELAY = "the host's delay (plant.drive.lead, lab.actuator.delay)"
NOISE_UNSTATED = (
    "headings are not as predicted, and the camera's noise is not stated: "
    "controller.prior.position_noise, heading_noise"
)
"""What is said if headings of cells do not fit whose camera's noise is unknown. In three specs that
did not state it, the interval of the turning rate was right for 40 of 43 such robots, and for all
with it (docs/decisions/filter.md)."""
LOOK_S = 0.15
"""Time at the end of a rest that is examined [s]. Before, a robot that missed the stop drives on
until its watchdog stops it: 0.25 s and a dead time, of a rest of 0.55 s."""
LEAST_FRAMES = 6
"""Least number of frames of that time."""
LEAST_SHARE = 0.05
"""Least speed that is said, as a fraction of the robot's."""
REST_SURE_STDS = 5.0
"""Least way that is said, in standard deviations of the difference of two mean places."""


@dataclass(frozen=True, slots=True)
class StatedModel:
    """What a spec states that a trial may contradict: the time from a command to its effect [s],
    the `delays` in it whose errors are errors of this time, and whether it lacks the noise of a
    camera that sees cells, of which none is usual."""

    dead_time_s: float
    delays: tuple[str, ...] = (DEAD_TIME,)
    lacks_noise: bool = False


def stated_model(experiment: Experiment) -> StatedModel:
    """Return what a spec states that a trial may contradict."""
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


def other_delay(estimate: Estimate, stated: StatedModel) -> str:
    """Return in words that commands act later or earlier than a spec states, by more than standard
    deviations explain; "" if they do not or it is not known."""
    now_s = estimate.dead_time
    std_s = estimate.dead_time_std
    if now_s is None or std_s is None:
        return ""
    if abs(now_s - stated.dead_time_s) <= max(DELAY_S, SURE_STDS * std_s):
        return ""
    delays = " or ".join(stated.delays)
    return (
        f"commands act {now_s:.3f} s after they are sent, not {stated.dead_time_s:.3f} s: "
        f"is {delays} wrong?"
    )


def turning(estimate: Estimate, i: int) -> str:
    """Return what is known of how robot i turns beyond its rate a, "" for nothing."""
    parts = list[str]()
    side = estimate.side
    std = estimate.side_std
    most = estimate.saturation
    if side is not None and std is not None and abs(side[i]) > SURE_STDS * std[i]:
        way = "left" if side[i] > 0 else "right"
        parts.append(f"turns {100 * math.expm1(2 * abs(side[i])):.0f} % faster to the {way}")
    if most is not None and side is not None and most[i] < 1:
        fastest = estimate.a[i] * math.exp(abs(side[i])) * most[i]
        parts.append(f"turns at {fastest:.2g} rad/s at most")
    return ", ".join(parts)


def differs(
    value: float | None, std: float | None, value_before: float | None, std_before: float | None
) -> bool:
    """Return whether two numbers differ by more than their standard deviations explain; those that
    are not known, None, do not."""
    if value is None or std is None or value_before is None or std_before is None:
        return False
    return abs(value - value_before) > SURE_STDS * math.hypot(std, std_before)


def learnt(estimate: Estimate, before: Estimate, setup: Setup) -> Iterator[str]:
    """Yield in words what is estimated otherwise than `before`, by more than standard deviations
    explain."""
    time_s = estimate.dead_time
    before_s = before.dead_time
    if differs(time_s, estimate.dead_time_std, before_s, before.dead_time_std):
        yield f"commands act {time_s:.3f} s after they are sent, not {before_s:.3f} s"
    for i, name in enumerate(setup.names):
        if differs(estimate.a[i], estimate.a_std[i], before.a[i], before.a_std[i]):
            yield f"a of {name} is {estimate.a[i]:.3g} rad/s, not {before.a[i]:.3g}"
        if differs(estimate.speed[i], estimate.speed_std[i], before.speed[i], before.speed_std[i]):
            now = f"{estimate.speed[i]:.3g} {setup.unit}/s"
            yield f"speed of {name} is {now}, not {before.speed[i]:.3g}"
        turns = turning(estimate, i)
        if turns and turns != turning(before, i):
            yield f"{name} {turns}"


class ModelNews:
    """Tells what is new about a controller's model, once a trial each (`_once`): that it does not
    fit, which robots stand or receive commands late, and that commands act at another time than
    `stated`. Only a misfit is reported again, once all have fitted for FITS_S since."""

    def __init__(self, stated: StatedModel | None = None) -> None:
        self._stated = stated
        self._said: set[str] = set()  # keys of what was said in this trial
        self._later_since_ns: dict[str, int] = {}  # of robots that are later now
        self._unfit: set[str] = set()  # what was said not to fit
        self._unfit_ns = 0  # time at which something last did not fit
        self._before: Estimate | None = None  # the estimate when that began, None while all fit

    def of(self, estimate: Estimate, setup: Setup, now_ns: int) -> Iterator[tuple[str, str]]:
        """Yield level and text of what is news in an estimate, and note that it is said."""
        for name in estimate.standing(setup.names):
            yield from self._once("info", f"{name} stands although it is sent a direction")
        for part in sorted(estimate.unexplained(setup.names, OF_PLACES)):
            yield from self._once("info", f"{part} is not as predicted, which says nothing of a")
        yield from self._later(estimate, setup, now_ns)
        unfit = estimate.unexplained(setup.names, OF_TURNING)
        if self._stated is not None and self._stated.lacks_noise:
            if unfit:
                yield from self._once("warning", NOISE_UNSTATED)
        else:
            yield from self._fit(unfit, estimate, setup, now_ns)

    def _once(self, level: str, text: str, key: str = "") -> Iterator[tuple[str, str]]:
        """Yield level and text unless it, or another text with its `key`, was said."""
        key = key or text
        if key not in self._said:
            self._said.add(key)
            yield level, text

    def _later(self, estimate: Estimate, setup: Setup, now_ns: int) -> Iterator[tuple[str, str]]:
        """Yield level and text of each robot on which commands have surely acted later than on the
        quickest one for LATER_FOR_S."""
        since_before = self._later_since_ns
        self._later_since_ns = {}
        delays_s = estimate.own_dead_time
        stds = estimate.own_dead_time_std
        if delays_s is None or stds is None:
            return
        quickest = int(delays_s.argmin())
        for i, name in enumerate(setup.names):
            difference_s = delays_s[i] - delays_s[quickest]
            least_s = max(LATER_S, SURE_STDS * math.hypot(stds[i], stds[quickest]))
            if difference_s > least_s:
                self._later_since_ns[name] = since_before.get(name, now_ns)
                text = f"commands act on {name} some {difference_s:.2f} s later than on "
                text += f"{setup.names[quickest]}, or more: its radio or its wheels are slow"
                if now_ns - self._later_since_ns[name] >= LATER_FOR_S * SECOND:
                    yield from self._once("warning", text, key=f"later: {name}")

    def _fit(
        self, unfit: set[str], estimate: Estimate, setup: Setup, now_ns: int
    ) -> Iterator[tuple[str, str]]:
        """Yield level and text of what does not fit, or of what was learnt since that is over."""
        if unfit:
            self._before = self._before or estimate
            self._unfit_ns = now_ns
            new = unfit - self._unfit
            if new:
                self._unfit |= new
                yield "warning", f"the model does not fit: {', '.join(sorted(new))}"
            question = other_delay(estimate, self._stated) if self._stated is not None else ""
            if question:  # of the spec, which a trial does not change
                yield from self._once("warning", question, key="dead time")
        elif self._before and now_ns - self._unfit_ns >= FITS_S * SECOND:
            changes = "; ".join(learnt(estimate, self._before, setup)) or "with the same values"
            self._unfit = set()
            self._before = None
            yield "info", f"the model fits again: {changes}"


def speeds_at_rest(frames: Sequence[Observation]) -> Floats:
    """Return how fast robots (N,) surely moved at the end of some frames [length unit/s], 0 if they
    stood, or if there are too few frames."""
    robots = len(frames[-1].valid)
    from_ns = frames[-1].sampled_ns - round(LOOK_S * SECOND)
    last = [frame for frame in frames if frame.sampled_ns >= from_ns and frame.valid.all()]
    if len(last) < LEAST_FRAMES:
        return np.zeros(robots)
    half = len(last) // 2
    places = np.array([frame.poses.xy for frame in last])  # (F, N, 2)
    times_s = np.array([frame.seconds for frame in last])
    first = places[:half]
    second = places[half:]
    way = np.hypot(*(second.mean(axis=0) - first.mean(axis=0)).T)
    variance = first.var(axis=0, ddof=1) / len(first)
    variance += second.var(axis=0, ddof=1) / len(second)
    is_sure = way > REST_SURE_STDS * np.sqrt(variance.sum(axis=1))
    seconds = times_s[half:].mean() - times_s[:half].mean()
    return np.where(is_sure, way / seconds, 0.0)


class RestNews:
    """Says of each robot, once a trial, that it moves though all should stand."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._said: set[str] = set()

    def of(self, plan: Plan, frames: Sequence[Observation]) -> list[str]:
        """Return what is news of the frames since the command of a plan was sent."""
        if not isinstance(plan.instead, Stop):
            return []
        speeds = speeds_at_rest(frames)
        texts: list[str] = []
        for i, name in enumerate(self._setup.names):
            if speeds[i] > LEAST_SHARE * self._setup.speed[i] and name not in self._said:
                self._said.add(name)
                speed = f"{speeds[i]:.2g} {self._setup.unit}/s"
                texts.append(f"{name} moves by {speed} while it should stand")
        return texts
