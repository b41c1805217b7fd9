"""What a trial says of the controller's model: that it does not fit, what was learnt since, and who
stands."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from tetractl.core.clock import SECOND
from tetractl.core.plan import Estimate
from tetractl.core.setup import Setup
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab_section import LabSection

FITS_S = 5.0  # time without a misfit after which the model fits again [s]
SURE_STDS = 3.0  # least change of an estimate that is news, in standard deviations
DELAY_S = 0.01  # least error of a stated dead time that is news [s]


@dataclass(frozen=True, slots=True)
class StatedDelay:
    """The time from a command to its effect that a spec states [s], and whether the spec states its
    camera's `latency` too, whose error is an error of this time."""

    dead_time_s: float
    has_latency: bool


def stated_delay(experiment: Experiment) -> StatedDelay:
    """Return what a spec states of the time from a command to its effect."""
    plant = experiment.plant
    has_latency = isinstance(plant, LabSection) and hasattr(plant.camera, "latency")
    return StatedDelay(experiment.controller.dead_time, has_latency)


def other_delay(estimate: Estimate, stated: StatedDelay) -> str:
    """Return in words that commands act later or earlier than a spec states, by more than standard
    deviations explain; "" if they do not or it is not known."""
    now_s = estimate.dead_time
    if now_s is None or estimate.dead_time_std is None:
        return ""
    if abs(now_s - stated.dead_time_s) <= max(DELAY_S, SURE_STDS * estimate.dead_time_std):
        return ""
    text = (
        f"commands act {now_s:.3f} s after they are sent, not {stated.dead_time_s:.3f} s: "
        "is controller.dead_time right"
    )
    if not stated.has_latency:
        return f"{text}?"
    way = "short" if now_s > stated.dead_time_s else "long"
    return f"{text}, or lab.camera.latency too {way}?"


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


def learnt(estimate: Estimate, before: Estimate, setup: Setup) -> Iterator[str]:
    """Yield in words what is estimated otherwise than `before`, by more than standard deviations
    explain."""
    now = estimate.dead_time
    was = before.dead_time
    if now is not None and was is not None:
        std = math.hypot(estimate.dead_time_std or 0.0, before.dead_time_std or 0.0)
        if abs(now - was) > SURE_STDS * std:
            yield f"commands act {now:.3f} s after they are sent, not {was:.3f} s"
    for i, name in enumerate(setup.names):
        for what, unit in ("a", "rad/s"), ("speed", f"{setup.unit}/s"):
            (new, std), (old, old_std) = (
                (getattr(values, what)[i], getattr(values, f"{what}_std")[i])
                for values in (estimate, before)
            )
            if abs(new - old) > SURE_STDS * math.hypot(std, old_std):
                yield f"{what} of {name} is {new:.3g} {unit}, not {old:.3g}"
        turns = turning(estimate, i)
        if turns and turns != turning(before, i):
            yield f"{name} {turns}"


@dataclass(slots=True)
class ModelNews:
    """Tells changes of how a controller's model fits: each part that does not fit once, until all
    have fitted for FITS_S, and meanwhile, once, that commands act at another time than `stated`. Of
    each robot the first time that it stands is said: screen and log show every time."""

    stated: StatedDelay | None = None
    _said: set[str] = field(default_factory=set)  # what does not fit
    _before: Estimate | None = None  # the estimate when it was said
    _unfit_ns: int = 0  # time at which something last did not fit
    _delay_said: bool = False  # whether the dead time was said to differ from the stated one
    _stood: set[str] = field(default_factory=set)  # who has stood

    def of(self, estimate: Estimate, setup: Setup, now_ns: int) -> Iterator[tuple[str, str]]:
        """Yield level and text of what is news in an estimate."""
        for name in estimate.standing(setup.names):
            if name in self._stood:
                continue
            self._stood.add(name)
            yield "info", f"{name} stands although it is sent a direction"
        unfit = estimate.unfit(setup.names)
        if unfit:
            self._before = self._before or estimate
            self._unfit_ns = now_ns
            new = unfit - self._said
            if new:
                self._said |= new
                yield "warning", f"the model does not fit: {', '.join(sorted(new))}"
            if (
                self.stated
                and not self._delay_said
                and (text := other_delay(estimate, self.stated))
            ):
                self._delay_said = True
                yield "warning", text
        elif self._before and now_ns - self._unfit_ns >= FITS_S * SECOND:
            changes = "; ".join(learnt(estimate, self._before, setup)) or "with the same values"
            self._said = set()
            self._before = None
            yield "info", f"the model fits again: {changes}"
