"""In what time a fault has to have ended the trial: the times of the fault table, as bounds.

They are derived in `docs/rehearsals.md`, and count time in which the guard let robots be driven.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

FRAME_S = 1 / 120  # between two exposures of the emulated camera
NOISE_MM = 4.0  # tolerance of a position, 2 mm, and as much noise
DRIVING_S = 0.03  # time of driving that the comparison of motion with commands allows
NOTICED_S = 0.05 + 3 * FRAME_S  # a pose is refused for 50 ms, and frames come one by one
WHEEL = 0.12  # `wheel_error`
Fields = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Due:
    """The bound [s] for a fault with such fields and a robot of a speed [mm/s]; NaN for none.

    It counts up to the last exposure shown, if `seen`. It holds for a fault that is `alone`, since
    another may explain what is seen; or once robots drove ahead, `steady`, for 0.3 s.
    """

    within_s: Callable[[Fields, float], float]
    seen: bool = True
    alone: bool = False
    steady: bool = False


def after(seconds: float, seen: bool = True) -> Due:
    """Return a bound that does not depend on the fault's size."""
    return Due(lambda f, v: seconds, seen)


def above(key: str, least: float, seconds: float, seen: bool = True, alone: bool = False) -> Due:
    """Return a bound for faults whose field `key`, a number or a vector, is at least so large."""

    def within(f: Fields, v: float) -> float:
        value = f.get(key, 0.0)
        size = math.hypot(*value) if key == "by" and f["fault"] in WAYS else abs(value)
        return seconds if size >= least else math.nan

    return Due(within, seen, alone)


WAYS = ("jump", "picture", "pushed")  # faults whose `by` is a vector


def _walk(f: Fields, v: float) -> float:
    """A pose that walks along or left of its robot leaves the tolerance, 0.03 s v and noise, at its
    speed less what wheels explain: `wheel_error` across; along, also their true error and lag.
    """
    along, left = (abs(step) / FRAME_S for step in f["by"])
    over = max(left - WHEEL * v, along - (WHEEL + 0.08) * v)
    took = (DRIVING_S * v + NOISE_MM) / over if over > 0 else math.inf
    return took + NOTICED_S if took < 0.8 else math.nan


def _stands(f: Fields, v: float) -> float:
    """A robot that stands falls behind by the tolerance at its speed less `wheel_error`."""
    whole = f["wheel"] == "both" and f.get("share", 0.0) == 0.0
    return (DRIVING_S * v + NOISE_MM) / ((1 - WHEEL) * v) + NOTICED_S if whole else math.nan


def plans(period_s: float) -> Due:
    """Return the bound for plans that take long: no direction for six periods, and half a second at
    least; or five steps in a row later than a period.
    """
    silent_s = max(0.5, 6 * period_s) + 0.05

    def within(f: Fields, v: float) -> float:
        seconds = f["seconds"] if f.get("every", 1) == 1 else 0.0
        if seconds >= silent_s:
            return silent_s + 0.05
        late = 5 * (seconds + period_s) + seconds + 0.05
        return late if seconds >= period_s + 0.01 else math.nan

    return Due(within, seen=False, alone=True, steady=True)


def _weak(f: Fields, v: float) -> float:
    return 2.0 if f["share"] <= 0.7 else math.nan


WALKS = Due(_walk, alone=True)
WALKS_AHEAD = Due(_walk, alone=True, steady=True)
TURNS = Due(lambda f, v: 0.75 if abs(f["turn"]) / FRAME_S >= 1.2 else math.nan, alone=True)
STANDS = Due(_stands, alone=True, steady=True)
REPEATS = Due(lambda f, v: 0.3 + 3 * FRAME_S, alone=True, steady=True)
PLANS = plans(0.05)
WEAK = Due(_weak, alone=True)
