"""Check whether actions, plans and estimates can be sent to robots and written to a log.

A controller from a plug-in may return anything, and a log that somebody else wrote may contain
anything. This module checks both. Each `check_` function raises ValueError for the first value that
no trial can have.
"""

from collections.abc import Iterable
from dataclasses import fields

import numpy as np

from tetractl.core.commands import Action, Steer, Turn
from tetractl.core.errors import printable
from tetractl.core.motion_estimate import INNOVATIONS, Estimate
from tetractl.core.plan import Plan, StopReason
from tetractl.core.poses import Floats

LOGGED_ESTIMATE_FIELDS = tuple(column.name for column in fields(Estimate) if column.compare)
"""The fields of an estimate that logs contain, in the order of the log's message."""
STOP_REASON_MAX = 60
"""Maximum number of characters of the reason why a search stopped."""
NUMBERS_MAX = 100
"""Maximum number of values that a controller may report in the `numbers` of one plan."""
NUMBER_NAME_MAX = 60
"""Maximum number of characters of a name in the `numbers` of a plan."""
DRAWING_BITS_CUT = 10
"""Number of bits that `round_for_drawing` sets to 0, of the 24 bits of a single-precision fraction.
"""
DRAWING_PRECISION = 2.0 ** (DRAWING_BITS_CUT - 24)
"""Maximum relative rounding error of `round_for_drawing`."""


def check_actions(actions: Iterable[Action]) -> None:
    """Raise ValueError if a direction or a wheel lag in an action is not a finite number."""
    directions: list[float] = []
    lags: list[float] = []
    for action in actions:
        match action:
            case Steer():
                directions.append(action.direction)
                if action.lag_s is not None:
                    lags.append(action.lag_s)
            case Turn():
                directions.append(action.facing)
            case _:
                pass  # no other action has a direction
    require_finite("a direction", directions)
    require_finite("the lag of the wheels", lags)


def check_plan(plan: Plan, robots: int) -> None:
    """Check that a plan for N robots can be sent and logged, and raise ValueError if it cannot.

    Arrays must have matching shapes, all numbers must be finite (except the headings of the path),
    and the names of the controller's own numbers must be short identifiers.

    Args:
        plan: The plan.
        robots: The number N of robots.
    """
    signal_count = plan.signals.size
    if plan.signals.shape != (signal_count,) or plan.path.shape != (signal_count + 1, robots, 3):
        raise ValueError(
            f"a path has shape {plan.path.shape} and its signals have shape {plan.signals.shape}, "
            f"but for {robots} robots and n signals, the shapes must be (n + 1, {robots}, 3) and "
            "(n,)"
        )
    searches = plan.searches
    for search in searches:
        if not (search.signals.shape == (search.length,) and search.length):
            raise ValueError(
                f"the `length` of a search is {_format_integer(search.length)}, but it must be the "
                "number of its signals, and at least 1"
            )
        if search.history.ndim != 1 or not search.history.size:
            raise ValueError("the history of a search must be a list of one or more numbers")
        if not isinstance(search.stopped, str):
            type_name = type(search.stopped).__name__
            raise ValueError(
                f"the field `stopped` of a search must be a string, but it is of type {type_name}"
            )
    if len(plan.numbers) > NUMBERS_MAX:
        raise ValueError(
            f"a plan has {len(plan.numbers)} entries in `numbers`, but at"
            f" most {NUMBERS_MAX} are allowed"
        )
    for name in plan.numbers:
        if not (name.isidentifier() and len(name) <= NUMBER_NAME_MAX):
            raise ValueError(
                f"the entry {printable(name, NUMBER_NAME_MAX)!r} of a "
                "plan's `numbers` must be a name of letters, digits and _"
            )
    costs = [plan.cost, plan.target_cost, plan.obstacle_cost]
    costs += [search.cost for search in searches]
    numbers_by_name = {
        "a predicted position": round_for_drawing(plan.path[..., :2]).ravel(),
        "a signal": np.concatenate([plan.signals, *(search.signals for search in searches)]),
        "a cost": np.concatenate([costs, *(search.history for search in searches)]),
    }
    numbers_by_name |= {f"the number {name}": [number] for name, number in plan.numbers.items()}
    if plan.estimate is not None:
        numbers_by_name |= _numbers_of_estimate(plan.estimate, robots)
    for name_of_numbers, numbers in numbers_by_name.items():
        require_finite(name_of_numbers, numbers)


def _numbers_of_estimate(estimate: Estimate, robots: int) -> dict[str, Floats]:
    """Return all numbers of an estimate of N robots, keyed by their meaning.

    Raises:
        ValueError: If an array is not of N robots.
    """
    values: dict[str, Floats] = {}
    for name in LOGGED_ESTIMATE_FIELDS:
        value = getattr(estimate, name)
        if value is None:
            continue
        if isinstance(value, np.ndarray):
            shape = (robots, len(INNOVATIONS)) if name == "misfit" else (robots,)
            if value.shape != shape:
                raise ValueError(
                    f"an estimated {name} has shape {value.shape}, but it must be {shape}"
                )
        values[f"an estimated {name}"] = np.atleast_1d(value).ravel()
    return values


@np.errstate(all="ignore")  # numbers beyond single precision
def round_for_drawing(values: Floats) -> Floats:
    """Round numbers that are only used for drawing to 14 significant bits, in a new array.

    The zeros at the end take almost no space in a compressed log.
    """
    rounding_bit = 1 << (DRAWING_BITS_CUT - 1)
    kept_bits_mask = -(1 << DRAWING_BITS_CUT)
    float_bits = values.astype(np.float32).view(np.int32)
    return ((float_bits + rounding_bit) & kept_bits_mask).view(np.float32).astype(np.float64)


def stop_reason(text: str) -> StopReason | str:
    """Convert a string to the reason why a search stopped.

    If there is no such reason, the result is the string itself, made printable and cut to
    STOP_REASON_MAX characters.
    """
    reason = printable(text, STOP_REASON_MAX)
    try:
        return StopReason(reason)
    except ValueError:
        return reason


def require_finite(description: str, values: Iterable[float]) -> None:
    """Raise ValueError if a value is infinite or NaN. The message begins with `description`."""
    numbers = np.asarray(values, dtype=np.float64)
    non_finite = numbers[~np.isfinite(numbers)]
    if non_finite.size:
        raise ValueError(f"{description} is {float(non_finite.flat[0])!r}")


def _format_integer(number: int) -> str:
    return str(number) if abs(number) < 10**20 else "a number of more than 20 digits"
