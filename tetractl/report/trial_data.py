"""The data of one trial for the player in an HTML page: compressed JSON, with null for NaN.

The script assets/data.js unpacks it in the browser.
"""

import base64
import json
import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.errors import format_unit
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.write.encoder import SHOWN_HZ
from tetractl.statistics.built_in_statistics import MEANINGS
from tetractl.verification.dish_pictures import REPORT_IMAGES_MAX, DishPictures
from tetractl.view.plan_words import describe_activity, describe_search_end
from tetractl.view.player import find_end_ns, find_first_positions

PLAN_DECIMALS_FEWER = 3
"""Number of decimals that positions in plans have less than measured positions.

The error is at most a thousandth of the arena.
"""


def pack_trial(trial: dict[str, Any]) -> str:
    """Compress the data of a trial by zlib, and return it as base64 text.

    NaN and infinite numbers raise a `ValueError`.
    """
    text = json.dumps(trial, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    compressed = zlib.compress(text.encode(), 9)
    return base64.b64encode(compressed).decode()


def round_to_lists(values: ArrayLike, decimals: int = 3) -> list[Any]:
    """Round an array, and return it as nested lists. NaN and infinite values become None."""
    numbers = np.asarray(values, dtype=float)
    items = np.round(numbers, decimals).astype(object)
    items[~np.isfinite(numbers)] = None
    return items.tolist()


def round_significant(values: ArrayLike) -> list[float | None]:
    """Round values (n,) to four significant digits. NaN and infinite values become None."""
    numbers = np.asarray(values, dtype=float).tolist()
    return [float(f"{number:.4g}") if math.isfinite(number) else None for number in numbers]


def trial_data(log: TrialLog, file: str, plans: bool = True) -> dict[str, Any]:
    """Return the data of a trial of N robots that the player of an HTML page shows.

    Lengths are in `unit`, times [s] count from the first direction sent. `frames.xy` (M, N, 2) and
    `frames.heading` (M, N) are measured poses, thinned to `SHOWN_HZ`. For each of K control steps,
    `steps` contains time, direction u (None while robots stand still or turn on the spot, which
    `describe_activity` states), solve time, and cost J and number of signals of the plan unless the
    robots stand still. `final` are the poses and errors of the result, at the time `end`. With
    `plans`, `plan` contains the predicted positions (K, H, N, 2) and `history` the values of J over
    the chosen search's iterations; H differs from step to step. `dish` contains a microscope's
    images, for a trial with `plans`.

    Args:
        log: The trial.
        file: Name of its log.
        plans: Whether to include plans.
    """
    setup = log.start.setup
    arena = setup.arena
    result = log.result
    decimals = 7 - math.ceil(math.log10(arena.longer_side))  # of lengths
    until_ns = find_end_ns(log)
    return {
        "file": file,
        "unit": format_unit(setup.unit),
        "arena": [arena.left, arena.bottom, arena.right, arena.top],
        "obstacles": [shape.outline().tolist() for shape in setup.obstacles],
        "robots": _robots(log),
        "hold": setup.hold.radius if setup.hold else 0,
        "frames": _frames(log, until_ns, decimals),
        "steps": _steps(log),
        "end": round(log.elapsed_s(until_ns), 3),
        "final": _final(log, decimals),
        "plan": _plans(log, decimals) if plans else None,
        "history": [round_significant(step.plan.search.history) for step in log.steps]
        if plans
        else None,
        "dish": _dish(log) if plans else None,
        "events": _events(log),
        "outcome": result.outcome.value if result else "the log ends early",
        "reason": result and (result.reason or MEANINGS[result.outcome]),
    }


def _robots(log: TrialLog) -> list[dict[str, Any]]:
    """Return each robot as data: name, colour, first measured position, target, and via points.

    A robot that was never seen gets its start in the spec.
    """
    setup = log.start.setup
    colors = robot_colors(setup.names, setup.colors)
    starts = find_first_positions(log.positions, setup.starts.xy).tolist()
    legs = setup.legs.swapaxes(0, 1).tolist()
    return [
        {
            "name": name,
            "color": colors[robot],
            "start": starts[robot],
            "target": legs[robot][-1],
            "via": legs[robot][:-1],
        }
        for robot, name in enumerate(setup.names)
    ]


def _frames(log: TrialLog, until_ns: int, decimals: int) -> dict[str, Any]:
    """Return the measured poses that the player shows, with the times of their frames [s].

    x, y and heading are None for a robot that a frame does not track.
    """
    frames = _thin_frames(log, until_ns)
    valid = log.valid[frames]
    heading = np.where(valid, log.mocap[frames, :, 2], np.nan)
    return {
        "t": round_to_lists(log.frames_s[frames]),
        "xy": round_to_lists(log.positions[frames], decimals),
        "heading": round_to_lists(heading),
    }


def _steps(log: TrialLog) -> dict[str, Any]:
    """Return the data of each control step for the player, as lists of one value per step.

    The cost and the number of signals are None for a step in which the plan pauses the robots.
    """
    steps = log.steps
    plans = [step.plan for step in steps]
    return {
        "t": round_to_lists(log.steps_s),
        "u": [plan.direction for plan in plans],
        "doing": [describe_activity(plan) for plan in plans],
        "cost": round_significant([np.nan if plan.pauses else plan.cost for plan in plans]),
        "signals": [None if plan.pauses else len(plan.signals) for plan in plans],
        "solve_ms": round_significant([step.solve_ns / MILLISECOND for step in steps]),
        "ended": ["–" if plan.pauses else describe_search_end(plan.search) for plan in plans],
    }


def _final(log: TrialLog, decimals: int) -> dict[str, Any] | None:
    """Return the final poses and errors, from the trial's result.

    The result is None if the log ends early.
    """
    result = log.result
    if result is None:
        return None
    return {
        "xy": round_to_lists(result.verdict.final.xy, decimals),
        "errors": round_to_lists(result.robot_errors, decimals),
        "known": "true" if log.start.plant.simulated else "measured",
    }


def _plans(log: TrialLog, decimals: int) -> list[Any]:
    """Return the positions (x, y) that the plan of each control step predicted.

    They are rounded to `decimals` minus PLAN_DECIMALS_FEWER decimals.
    """
    return [
        round_to_lists(step.plan.path[..., :2], decimals - PLAN_DECIMALS_FEWER)
        for step in log.steps
    ]


def _events(log: TrialLog) -> list[dict[str, Any]]:
    """Return the events of the trial in their order, with the time [s], the level and the text."""
    return [{"t": event.time_s, "level": event.level, "text": event.text} for event in log.events]


def _thin_frames(log: TrialLog, until_ns: int) -> NDArray[np.intp]:
    """Select the frames to show, at most `SHOWN_HZ` per second, and return their indices.

    No frame is more than one control period before the first direction, or later than `until_ns`.
    """
    before_end = log.mocap_ns <= until_ns
    times_ns = log.mocap_ns[before_end]
    from_ns = log.began_ns - round(log.start.setup.period_s * SECOND)
    from_start = np.flatnonzero(times_ns >= from_ns)
    if not len(from_start):
        return np.arange(len(times_ns))
    slots = (times_ns[from_start] - times_ns[from_start[0]]) * SHOWN_HZ // 1e9
    first_of_slot = np.flatnonzero(np.diff(slots, prepend=-1) > 0)
    return from_start[np.union1d(first_of_slot, [len(from_start) - 1])]


def _dish(log: TrialLog) -> dict[str, Any] | None:
    """Return a microscope's images as JPEG, with times and corners.

    The result is None if the log has no images.
    """
    pictures = DishPictures(log, REPORT_IMAGES_MAX)
    if not pictures.times_ns:
        return None
    files = map(pictures.jpeg, range(len(pictures.times_ns)))
    return {
        "t": round_to_lists([log.elapsed_s(time_ns) for time_ns in pictures.times_ns]),
        "corners": pictures.corners.tolist(),
        "jpeg": [base64.b64encode(data).decode() for data in files],
    }
