"""Checks of a disturbance, which call each method as the simulation does."""

from collections.abc import Callable
from dataclasses import astuple, is_dataclass
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Setup
from tetractl.spec.disturbance import (
    DelayedCommand,
    Disturbance,
    DisturbanceSection,
    overriding,
)
from tetractl_testing.expect import SEED, expect, expect_same, expect_true, random_watched

FRAME_NS = SECOND // 60
"""Time between two frames [ns]."""
FRAMES = 180
"""Number of frames in a check: 3 s."""
FRAMES_OF_PERIOD = 12
"""Number of frames in a control period, 0.2 s."""
FITS = {
    "parameters": "finite, at least 0, shape (N,)",
    "placed": "finite",
    "varied": "finite, at least 0, shape (N,)",
    "planning_s": "from 0 to planning_max_s",
    "sent": "reaches no additional robots, and not before it was sent",
    "moved": "finite, and unchanged if no time passes",
    "measured": "finite where valid",
    "received": "not before the exposure, and None only if loses_frames is set",
}
"""Requirement for the result of each method, by the method's name, as messages state it."""


Call = tuple[bool, bool, Floats]
"""The record of a call of a method.

Its entries are: whether the result fulfils the requirement in `FITS`, whether the arguments are
unchanged, and the numbers in the result.
"""


def check_disturbance(section: DisturbanceSection, setup: Setup) -> None:
    """Check the results of each overridden method, and that they depend only on the seed.

    At least one method must be overridden, and no method may change its arguments.
    """
    with random_watched() as generators_used:
        calls = _calls(section, setup)
        calls_again = _calls(section, setup)
    expect("methods: there is at least one", "" if calls else "overrides none")
    for method, method_calls in calls.items():
        fits, unchanged, numbers = zip(*method_calls, strict=True)
        *_, numbers_again = zip(*calls_again[method], strict=True)
        expect_true(f"{method}: {FITS[method]}", fits)
        expect_true(f"{method}: does not change its arguments", unchanged, "changed")
        expect_same(f"{method}: the same seed gives the same results", numbers, numbers_again)
    expect("random numbers: come only from rng", " and ".join(generators_used))


def _calls(section: DisturbanceSection, setup: Setup) -> dict[str, list[Call]]:
    """Call each overridden method of a disturbance for `FRAMES` frames, as the simulation does.

    Returns:
        The calls of each method.
    """
    disturbance = section.build(setup, np.random.default_rng(SEED))
    calls: dict[str, list[Call]] = {}

    def call(bound: Callable[..., Any], *arguments: Any) -> Any:
        """Call a method and record the call. Returns None if the method is not overridden."""
        method = bound.__name__
        if not overriding([disturbance], getattr(Disturbance, method)):
            return None
        arguments_before = _flat(arguments)
        result = bound(*arguments)
        unchanged = np.array_equal(arguments_before, _flat(arguments), equal_nan=True)
        fulfils = bool(_fits(method, section, arguments, result))
        method_calls = calls.setdefault(method, [])
        method_calls.append((fulfils, unchanged, _flat(result)))
        return result

    n_robots = len(setup.names)
    all_robots = np.ones(n_robots, dtype=np.bool_)
    parameters = call(disturbance.parameters, setup.a.copy(), setup.speed.copy())
    a, speed = parameters or (setup.a, setup.speed)
    poses = Poses.from_array(setup.starts.array())
    poses = call(disturbance.placed, poses) or poses
    for k in range(FRAMES):
        now_ns = k * FRAME_NS
        now_s = now_ns / SECOND
        passed_s = 0.0 if k == 0 else FRAME_NS / SECOND
        moving = np.full(n_robots, 0.0 if k == 0 else 1.0)
        poses = call(disturbance.moved, poses, moving, passed_s, now_s) or poses
        call(disturbance.varied, a.copy(), speed.copy(), now_s)
        call(disturbance.measured, poses, all_robots.copy(), now_s)
        call(disturbance.received, now_ns, now_ns + FRAME_NS)
        if k % FRAMES_OF_PERIOD == 0:
            call(disturbance.planning_s, now_s)
            call(disturbance.sent, _command(now_ns, all_robots))
    return calls


def _command(now_ns: int, reached: Bools) -> DelayedCommand:
    """Create a command that is sent and due at `now_ns`, and reaches the robots `reached` (N,)."""
    wheels = np.ones((2, len(reached)))
    return DelayedCommand(now_ns, now_ns, Steer(0.5), reached, wheels=wheels)


def _fits(method: str, section: DisturbanceSection, arguments: Any, result: Any) -> Any:
    """Check whether the result of a method fulfils the requirements in `FITS`."""
    match method:
        case "planning_s":
            return 0 <= result <= section.planning_max_s
        case "received":
            exposed_ns = arguments[0]
            return section.loses_frames if result is None else result >= exposed_ns
        case "sent":
            command = arguments[0]
            late_ns = 0 if result.late_ns is None else result.late_ns
            due_ns = result.due_ns + late_ns
            in_time = np.all(due_ns >= command.sent_ns)
            return in_time and np.all(result.reached <= command.reached)
        case "measured":
            poses, valid = result
            return _finite(poses.array()[valid])
        case "parameters" | "varied":
            has_right_shape = np.shape(result) == np.shape(arguments[:2]) and np.min(result) >= 0
            return has_right_shape and _finite(result)
        case "moved":
            poses, _, passed_s, _ = arguments
            strays = passed_s == 0 and (_flat(result) != _flat(poses)).any()
            return not strays and _finite(result)
    return _finite(result)


def _finite(value: Any) -> bool:
    numbers = _flat(value)
    return bool(np.isfinite(numbers).all())


def _flat(value: Any) -> Floats:
    """Flatten numbers, arrays, and nested dataclasses, tuples and lists of them to one array.

    None becomes NaN. Anything else, such as a mapping or text, raises TypeError or ValueError.
    """
    if is_dataclass(value) and not isinstance(value, type):
        value = astuple(value)
    if isinstance(value, tuple | list):
        return np.concatenate([np.zeros(0), *map(_flat, value)])
    return np.asarray(np.nan if value is None else value, dtype=float).ravel()
