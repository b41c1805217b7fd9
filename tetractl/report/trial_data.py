"""The data of one trial for the page's player, as an object for JSON.

Arrays are base64 of little-endian numbers, unpacked by assets/data.js.
"""

import base64
import math
from collections.abc import Sequence, Sized
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tetractl.core.colors import robot_colors
from tetractl.core.errors import unit_of
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.dish_pictures import MOST, DishPictures
from tetractl.replay.player import first_seen, tracked

FRAMES_HZ = 30.0
"""Largest rate of camera frames on the page [Hz], since screens show no more."""
PLAN_ERROR = 1e-3
"""Largest distance of a plan drawn on the page from the plan itself, relative to the arena's longer
side.
"""
HISTORY_ERROR = 5e-3
"""Largest distance of a drawn curve of log J over the iterations from the curve itself, relative to
the curve's size.
"""
MISSING = -32768
"""The 16-bit number that represents NaN."""
LARGEST = 32767


def floats(values: ArrayLike) -> dict[str, Any]:
    """Return an array in single precision as an object for JSON: {"f4": base64}."""
    return {"f4": _text(np.asarray(values, dtype="<f4"))}


def rounded(values: ArrayLike) -> dict[str, Any]:
    """Return an array in 16 bits: {"i2": base64, "scale": s, "offset": o}, where the integer i
    stands for o + s i.

    Rounding errors are at most 1/131,068 of the range of all values. A value that is not finite
    becomes `MISSING`.
    """
    wanted = np.asarray(values, dtype=float)
    finite = np.isfinite(wanted)
    least, most = (wanted[finite].min(), wanted[finite].max()) if finite.any() else (0.0, 0.0)
    offset = least / 2 + most / 2
    scale = (most / 2 - least / 2) / LARGEST
    if not (scale > 0 and math.isfinite(scale)):
        scale = 1.0
    steps = np.rint((np.where(finite, wanted, offset) - offset) / scale)
    packed = np.where(finite, np.clip(steps, -LARGEST, LARGEST), MISSING).astype("<i2")
    return {"i2": _text(packed), "scale": float(scale), "offset": float(offset)}


def _text(values: "np.ndarray[Any, Any]") -> str:
    return base64.b64encode(values.tobytes()).decode()


def trial_data(log: TrialLog, file: str, plans: bool = True) -> dict[str, Any]:
    """Return a trial of N robots for the player; lengths in `unit`, times [s] from the first
    direction sent.

    `frames.xy` (M, N, 2) and `frames.heading` (M, N) are measured poses, thinned to `FRAMES_HZ`.
    For each control step, `steps` contains time, direction u (NaN while robots pause or turn, which
    `doing` states), cost J, number of signals, solve time and the robots' distances to their
    targets (K, N). With `plans`, `plan` contains the predicted positions and `history` the
    iterations and J of the chosen search; step k has the entries `at[k]` to `at[k + 1]`. Points of
    both that are close to a straight line between other points are left out. `dish` contains a
    microscope's pictures, for a trial with `plans`.
    """
    setup, steps = log.start.setup, log.steps
    colors = robot_colors(setup.names, setup.colors)
    result, keep = log.result, _thinned(log)
    xy = np.where(log.valid[keep][..., None], log.mocap[keep][..., :2], np.nan)
    starts = first_seen(tracked(log.mocap, log.valid), setup.starts.xy)
    sent = [log.elapsed_s(step.command.sent_ns) for step in steps]
    directions = [step.plan.direction for step in steps]
    observed = np.array([step.observation.poses.xy for step in steps])
    distances = setup.distances(observed.reshape(-1, len(setup.names), 2))
    arena = setup.arena
    return {
        "file": file,
        "unit": unit_of(setup.unit),
        "period_s": setup.period_s,
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
            "t": floats([log.elapsed_s(int(t)) for t in log.mocap_ns[keep]]),
            "xy": rounded(xy),
            "heading": rounded(np.where(log.valid[keep], log.mocap[keep][..., 2], np.nan)),
        },
        "steps": {
            "t": floats(sent),
            "u": floats([np.nan if u is None else u for u in directions]),
            "doing": [step.plan.doing for step in steps],
            "cost": floats([step.plan.cost for step in steps]),
            "signals": [len(step.plan.signals) for step in steps],
            "solve_ms": floats([step.solve_ns / 1e6 for step in steps]),
            "stopped": [str(step.plan.search.stopped) for step in steps],
            "distance": floats(distances),
        },
        "plan": _plans(log) if plans else None,
        "history": _histories(log) if plans else None,
        "dish": _dish(log) if plans else None,
        "events": [{"t": e.time_s, "level": e.level, "text": e.text} for e in log.events],
        "outcome": result.outcome.value if result else "the log ends early",
        "reason": result and (result.reason or result.outcome.meaning),
        "total": result.total_error if result else None,
        "errors": list(result.robot_errors) if result else None,
        "duration_s": result.duration_s if result else None,
    }


def _thinned(log: TrialLog) -> "np.ndarray[Any, np.dtype[np.intp]]":
    """Return the indices of the frames to show: at most `FRAMES_HZ` per second, none earlier than
    one control period before the first direction.
    """
    times = log.mocap_ns
    from_start = np.flatnonzero(times >= log.began_ns - round(log.start.setup.period_s * 1e9))
    if not len(from_start):
        return np.arange(len(times))
    slots = (times[from_start] - times[from_start[0]]) * FRAMES_HZ // 1e9
    first = np.flatnonzero(np.diff(slots, prepend=-1) > 0)
    return from_start[np.union1d(first, [len(from_start) - 1])]


def _dish(log: TrialLog) -> dict[str, Any] | None:
    """Return a microscope's pictures as JPEG, with their times and corners; None without any."""
    pictures = DishPictures(log, MOST)
    if not pictures.times:
        return None
    files = map(pictures.jpeg, range(len(pictures.times)))
    return {
        "t": floats([log.elapsed_s(at) for at in pictures.times]),
        "corners": pictures.corners.tolist(),
        "jpeg": [base64.b64encode(data).decode() for data in files],
    }


def _plans(log: TrialLog) -> dict[str, Any]:
    arena = log.start.setup.arena
    error = PLAN_ERROR * max(arena.width, arena.height)
    paths = [step.plan.path[..., :2] for step in log.steps]
    kept = corners(paths, error)
    few = [path[keep] for path, keep in zip(paths, kept, strict=True)]
    return {"at": _starts(few), "values": rounded(_joined(few))}


def _histories(log: TrialLog) -> dict[str, Any]:
    histories = [step.plan.search.history for step in log.steps]
    kept = corners([_on_log_axes(history)[:, None] for history in histories], HISTORY_ERROR)
    costs = [history[keep] for history, keep in zip(histories, kept, strict=True)]
    return {
        "at": _starts(kept),
        "iterations": floats(_joined(kept)),
        "values": floats(_joined(costs)),
    }


def _on_log_axes(history: Floats) -> Floats:
    """Return the points (n, 2) of log J over the iterations, both axes scaled to length 1."""
    heights = np.log(np.clip(np.nan_to_num(history, posinf=np.inf), 1e-300, 1e300))
    size = float(np.ptp(heights)) or 1.0
    return np.column_stack([np.linspace(0, 1, len(history)), heights / size])


def corners(curves: Sequence[Floats], error: float) -> "list[np.ndarray[Any, np.dtype[np.intp]]]":
    """Return the increasing indices of the points to keep of each curve (n, N, 2) of N robots.

    The first and last points are kept. Every other point is within `error` of the straight line
    between the points kept before and after it (Douglas and Peucker 1973). All spans of all curves
    are divided at once.
    """
    lengths = np.array([len(curve) for curve in curves], dtype=np.intp)
    ends = np.cumsum(lengths)
    points = np.asarray(_joined([curve for curve in curves if len(curve)]))
    keep = np.zeros(len(points), dtype=bool)
    keep[(ends - lengths)[lengths > 0]] = keep[ends[lengths > 0] - 1] = True
    open_points = np.flatnonzero(~keep)
    while len(open_points):
        kept = np.flatnonzero(keep)
        span = np.searchsorted(kept, open_points)
        first, last = points[kept[span - 1]], points[kept[span]]
        inner, chord = points[open_points] - first, last - first
        length2 = np.maximum((chord**2).sum(axis=-1), 1e-300)
        share = np.clip((inner * chord).sum(axis=-1) / length2, 0, 1)[..., None]
        gaps = np.linalg.norm(inner - share * chord, axis=-1).max(axis=1)
        _, begins, sizes = np.unique(span, return_index=True, return_counts=True)
        widest = np.repeat(np.maximum.reduceat(gaps, begins), sizes)
        worst = np.flatnonzero((gaps == widest) & (gaps > error))
        keep[open_points[worst[np.unique(span[worst], return_index=True)[1]]]] = True
        open_points = open_points[(widest > error) & ~keep[open_points]]
    return [np.flatnonzero(keep[end - n : end]) for n, end in zip(lengths, ends, strict=True)]


def _starts(arrays: Sequence[Sized]) -> list[int]:
    return np.cumsum([0, *map(len, arrays)]).tolist()


def _joined(arrays: Sequence[ArrayLike]) -> ArrayLike:
    return np.concatenate(arrays) if arrays else np.zeros(0)
