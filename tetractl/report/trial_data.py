"""What the page's player shows of one trial, as an object for JSON."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.colors import robot_colors
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import TrialLog
from tetractl.report.pack import floats, rounded

FRAMES_HZ = 30.0
"""Camera frames of the page a second, at most: what a screen shows."""


@dataclass(frozen=True, slots=True)
class Detail:
    """How much of a trial the page holds: points of a plan and of a search's history, at most."""

    plan_points: int
    history_points: int

    @classmethod
    def of(cls, trials: int) -> "Detail":
        """Return the detail for a page of so many trials."""
        if trials <= 20:
            return cls(16, 30)
        return cls(6, 8) if trials <= 100 else cls(0, 0)


def trial_data(log: TrialLog, file: str, detail: Detail) -> dict[str, Any]:
    """Return a trial of N robots for the player; lengths in `unit`, times [s] from the first
    direction sent.

    `frames.xy` (M, N, 2) and `frames.heading` (M, N) are measured poses, thinned to `FRAMES_HZ`.
    Of each control step, `steps` holds time, direction u, cost J, number of signals, solve time and
    the robots' distances to their targets (K, N); `plan` and `history` hold the predicted positions
    and J over the iterations of the chosen search, those of step k from `at[k]` to `at[k + 1]`.
    """
    setup, steps = log.start.setup, log.steps
    colors = robot_colors(setup.names, setup.colors)
    starts, result = setup.starts.xy, log.result
    keep = _thinned(log)
    xy = np.where(log.valid[keep][..., None], log.mocap[keep][..., :2], np.nan)
    sent = [log.elapsed_s(step.command.sent_ns) for step in steps]
    directions = [step.plan.direction for step in steps]
    observed = np.array([step.observation.poses.xy for step in steps])
    distances = setup.distances(observed.reshape(-1, len(setup.names), 2))
    arena = setup.arena
    return {
        "file": file,
        "unit": setup.unit.replace("um", "µm"),
        "period_s": setup.period_s,
        "arena": [arena.left, arena.bottom, arena.right, arena.top],
        "obstacles": [shape.outline().tolist() for shape in setup.obstacles],
        "robots": [
            {"name": name, "color": color, "start": start, "target": target}
            for name, color, start, target in zip(
                setup.names, colors, starts.tolist(), setup.targets.tolist(), strict=True
            )
        ],
        "frames": {
            "t": floats([log.elapsed_s(int(t)) for t in log.mocap_ns[keep]]),
            "xy": rounded(xy),
            "heading": rounded(np.where(log.valid[keep], log.mocap[keep][..., 2], np.nan)),
        },
        "steps": {
            "t": floats(sent),
            "u": floats([np.nan if u is None else u for u in directions]),
            "cost": floats([step.plan.cost for step in steps]),
            "signals": [len(step.plan.signals) for step in steps],
            "solve_ms": floats([step.solve_ns / 1e6 for step in steps]),
            "stopped": [str(step.plan.search.stopped) for step in steps],
            "distance": floats(distances),
        },
        "plan": _ragged((step.plan.path[..., :2] for step in steps), detail.plan_points),
        "history": _ragged((step.plan.search.history for step in steps), detail.history_points),
        "events": [{"t": e.time_s, "level": e.level, "text": e.text} for e in log.events],
        "outcome": result.outcome.value if result else "the log ends early",
        "reason": result.reason if result else "",
        "total": result.total_error if result else None,
        "errors": list(result.robot_errors) if result else None,
        "duration_s": result.duration_s if result else None,
        "entered": result.entered_obstacle if result else None,
    }


def _thinned(log: TrialLog) -> "np.ndarray[Any, np.dtype[np.intp]]":
    """Return the frames to keep: those from the first direction on, `FRAMES_HZ` at most."""
    times = log.mocap_ns
    from_start = np.flatnonzero(times >= log.began_ns - round(log.start.setup.period_s * 1e9))
    if not len(from_start):
        return np.arange(len(times))
    slots = (times[from_start] - times[from_start[0]]) * FRAMES_HZ // 1e9
    first = np.flatnonzero(np.diff(slots, prepend=-1) > 0)
    return from_start[np.union1d(first, [len(from_start) - 1])]


def _ragged(arrays: Iterable[Floats], points: int) -> dict[str, Any] | None:
    """Return arrays of different lengths behind each other, `points` of each at most."""
    if not points:
        return None
    few = []
    for array in arrays:
        count = min(len(array), points)
        few.append(array[np.rint(np.linspace(0, len(array) - 1, count)).astype(int)])
    at = np.cumsum([0, *map(len, few)]).tolist()
    values = np.concatenate(few) if few else np.zeros(0)
    return {"at": at, "values": rounded(values) if values.ndim > 1 else floats(values)}
