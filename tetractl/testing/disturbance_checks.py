"""Checks of a disturbance, each method called as the plant does."""

from collections.abc import Callable
from dataclasses import astuple, is_dataclass
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.poses import Floats, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import DelayedCommand, DisturbanceSection, overriding
from tetractl.testing.finding import SEED, Finding, Findings, random_watched, same, true

FRAME_NS = SECOND // 60
FITS = {
    "parameters": "finite, not below 0, (N,)",
    "placed": "finite",
    "varied": "finite, not below 0, (N,)",
    "planning_s": "from 0 to planning_max_s",
    "sent": "reaches no further robots, not before it was sent",
    "moved": "finite, and unmoved in no time",
    "measured": "finite where valid",
    "received": "not before the exposure; None only with loses_frames",
}


def _fits(method: str, section: DisturbanceSection, given: Any, found: Any) -> Any:
    """Return whether a method's result is what `FITS` says."""
    match method:
        case "planning_s":
            return 0 <= found <= section.planning_max_s
        case "received":
            return section.loses_frames if found is None else found >= given[0]
        case "sent":
            late = (found.due_ns + (found.late_ns or 0)) >= given[0].sent_ns
            return np.all(late) and np.all(found.reached <= given[0].reached)
        case "measured":
            found = found[0].array()[found[1]]
        case "parameters" | "varied" if np.shape(found) != np.shape(given[:2]) or np.min(found) < 0:
            return False
        case "moved" if given[2] == 0 and (_flat(found) != _flat(given[0])).any():
            return False
    return np.isfinite(_flat(found)).all()


def _calls(section: DisturbanceSection, setup: Setup) -> dict[str, list[tuple[Any, bool, Floats]]]:
    """Call the methods that a disturbance overrides as the plant does, for 3 s.

    Returns by method, for each call: whether the result fits, whether the arguments are unchanged,
    and the numbers in the result.
    """
    disturbance = section.build(setup, np.random.default_rng(SEED))
    calls: dict[str, list[tuple[Any, bool, Floats]]] = {}

    def call(bound: Callable[..., Any], *given: Any) -> Any:
        method = bound.__name__
        if not overriding([disturbance], method):
            return None
        before = _flat(given)
        found = bound(*given)
        kept = np.array_equal(before, _flat(given), equal_nan=True)
        row = _fits(method, section, given, found), kept, _flat(found)
        calls.setdefault(method, []).append(row)
        return found

    every = np.ones(len(setup.names), dtype=np.bool_)
    a, speed = call(disturbance.parameters, setup.a.copy(), setup.speed.copy()) or (
        setup.a,
        setup.speed,
    )
    poses = Poses.of(setup.starts.array())
    poses = call(disturbance.placed, poses) or poses
    for k in range(180):
        now, passed_ns, moving = k * FRAME_NS, (k > 0) * FRAME_NS, np.full(every.size, float(k > 0))
        poses = call(disturbance.moved, poses, moving, passed_ns / SECOND, now / SECOND) or poses
        call(disturbance.varied, a.copy(), speed.copy(), now / SECOND)
        call(disturbance.measured, poses, every.copy(), now / SECOND)
        call(disturbance.received, now, now + FRAME_NS)
        if k % 12 == 0:  # once in a control period
            call(disturbance.planning_s, now / SECOND)
            wheels = np.ones((2, every.size))
            call(
                disturbance.sent,
                DelayedCommand(now, now, Steer(0.5), every, None, poses.heading.copy(), wheels),
            )
    return calls


def check_disturbance(section: DisturbanceSection, setup: Setup) -> Findings:
    """Check the results of each method, and that the seed alone determines them."""
    with random_watched() as used:
        calls, again = _calls(section, setup), _calls(section, setup)
    yield Finding("methods: at least one", "" if calls else "overrides none")
    for method, found in calls.items():
        fit, kept, numbers = zip(*found, strict=True)
        yield true(f"{method}: {FITS[method]}", fit)
        yield true(f"{method}: arguments unchanged", kept, "changed")
        yield same(f"{method}: same seed, same results", numbers, [one[2] for one in again[method]])
    yield Finding("random numbers: from rng", " and ".join(used))


def _flat(value: Any) -> Floats:
    """Return all numbers of a value in a row, NaN for None."""
    if is_dataclass(value) and not isinstance(value, type):
        value = astuple(value)
    if isinstance(value, tuple | list):
        return np.concatenate([np.zeros(0), *map(_flat, value)])
    return np.asarray(np.nan if value is None else value, dtype=float).ravel()
