"""The data of one trial for the page's player: compressed JSON, in which null stands for NaN.

assets/data.js unpacks it.
"""

import base64
import json
import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tetractl.core.colors import robot_colors
from tetractl.core.errors import unit_of
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.write.encoder import SHOWN_HZ
from tetractl.replay.dish_pictures import PICTURES_MAX, DishPictures
from tetractl.replay.player import end_ns, first_seen, tracked


def packed(trial: dict[str, Any]) -> str:
    """Return a trial as base64 of its JSON, compressed by zlib."""
    text = json.dumps(trial, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def rounded(values: ArrayLike, decimals: int = 3) -> list[Any]:
    """Return an array as lists, with None in place of values that are not finite."""
    wanted = np.asarray(values, dtype=float)
    found = np.round(wanted, decimals).astype(object)
    found[~np.isfinite(wanted)] = None
    return found.tolist()


def significant(values: ArrayLike) -> list[float | None]:
    """Return values (n,) with four significant digits, with None for those not finite."""
    texts = ((value, f"{value:.4g}") for value in np.asarray(values, dtype=float).tolist())
    return [float(text) if math.isfinite(value) else None for value, text in texts]


def trial_data(log: TrialLog, file: str, plans: bool = True) -> dict[str, Any]:
    """Return a trial of N robots for the player; lengths in `unit`, times [s] from the first
    direction sent.

    `frames.xy` (M, N, 2) and `frames.heading` (M, N) are measured poses, thinned to `SHOWN_HZ`.
    For each of K control steps, `steps` contains time, direction u (None while robots stand or turn
    on the spot, which `doing` states), solve time, and cost J and number of signals of the plan
    unless the robots stand. `final` are the poses and errors of the result, at the time `end`. With
    `plans`, `plan` contains the predicted positions (K, H, N, 2) and `history` the values of J over
    the chosen search's iterations; H differs from step to step. `dish` contains a microscope's
    pictures, for a trial with `plans`.
    """
    setup, steps = log.start.setup, log.steps
    decided = [step.plan for step in steps]
    colors = robot_colors(setup.names, setup.colors)
    until_ns, result = end_ns(log), log.result
    keep = _thinned(log, until_ns)
    xy = np.where(log.valid[keep][..., None], log.mocap[keep][..., :2], np.nan)
    starts = first_seen(tracked(log.mocap, log.valid), setup.starts.xy)
    arena = setup.arena
    # decimals of plans, at most a thousandth of the arena, and of what is shown in digits
    coarse = 4 - math.ceil(math.log10(max(arena.width, arena.height)))
    fine = coarse + 3
    return {
        "file": file,
        "unit": unit_of(setup.unit),
        "arena": [arena.left, arena.bottom, arena.right, arena.top],
        "obstacles": [shape.outline().tolist() for shape in setup.obstacles],
        "robots": [
            {"name": name, "color": color, "start": start, "target": legs[-1], "via": legs[:-1]}
            for name, color, start, legs in zip(
                setup.names,
                colors,
                starts.tolist(),
                setup.legs.swapaxes(0, 1).tolist(),
                strict=True,
            )
        ],
        "hold": setup.hold.radius if setup.hold else 0,
        "frames": {
            "t": rounded([log.elapsed_s(int(t)) for t in log.mocap_ns[keep]]),
            "xy": rounded(xy, fine),
            "heading": rounded(np.where(log.valid[keep], log.mocap[keep][..., 2], np.nan)),
        },
        "steps": {
            "t": rounded([log.elapsed_s(step.command.sent_ns) for step in steps]),
            "u": [step.plan.direction for step in steps],
            "doing": [step.plan.doing for step in steps],
            "cost": significant([np.nan if p.pauses else p.cost for p in decided]),
            "signals": [None if p.pauses else len(p.signals) for p in decided],
            "solve_ms": significant([step.solve_ns / 1e6 for step in steps]),
            "ended": ["–" if p.pauses else p.search.ended for p in decided],
        },
        "end": round(log.elapsed_s(until_ns), 3),
        "final": result
        and {
            "xy": rounded(result.verdict.final.xy, fine),
            "errors": rounded(result.robot_errors, fine),
            "known": "true" if log.start.plant.simulated else "measured",
        },
        "plan": [rounded(step.plan.path[..., :2], coarse) for step in steps] if plans else None,
        "history": [significant(step.plan.search.history) for step in steps] if plans else None,
        "dish": _dish(log) if plans else None,
        "events": [{"t": e.time_s, "level": e.level, "text": e.text} for e in log.events],
        "outcome": result.outcome.value if result else "the log ends early",
        "reason": result and (result.reason or result.outcome.meaning),
    }


def _thinned(log: TrialLog, until_ns: int) -> NDArray[np.intp]:
    """Return the indices of the frames to show: at most `SHOWN_HZ` per second, none earlier than
    one control period before the first direction, or later than `until_ns`.
    """
    times = log.mocap_ns[log.mocap_ns <= until_ns]
    from_start = np.flatnonzero(times >= log.began_ns - round(log.start.setup.period_s * 1e9))
    if not len(from_start):
        return np.arange(len(times))
    slots = (times[from_start] - times[from_start[0]]) * SHOWN_HZ // 1e9
    first = np.flatnonzero(np.diff(slots, prepend=-1) > 0)
    return from_start[np.union1d(first, [len(from_start) - 1])]


def _dish(log: TrialLog) -> dict[str, Any] | None:
    """Return a microscope's pictures as JPEG, with their times and corners; None without any."""
    pictures = DishPictures(log, PICTURES_MAX)
    if not pictures.times:
        return None
    files = map(pictures.jpeg, range(len(pictures.times)))
    return {
        "t": rounded([log.elapsed_s(at) for at in pictures.times]),
        "corners": pictures.corners.tolist(),
        "jpeg": [base64.b64encode(data).decode() for data in files],
    }
