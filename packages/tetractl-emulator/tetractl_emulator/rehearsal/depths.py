"""That robots are not driven on where they are seen to leave the arena, or to meet another.

A robot's true pose at an exposure that was shown, `reaction` ahead of it, is outside, or nearer to
another's than `separation_mm`, by more than its accepted pose was wrong and noise. From then on the
guard knows: no command drives it ahead that is sent a slack after a later exposure.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats
from tetractl.experiment.lab_section import UNTRACKED_STOP_S, LabLimits
from tetractl_emulator.rehearsal.truth import Truth
from tetractl_emulator.rehearsal.violation import SLACK_S, Violation

NOISE_MM = 4.0


def places(truth: Truth, limits: LabLimits) -> Iterator[Violation]:
    """Yield the first command that drives a robot out, and the first that drives two together."""
    if not len(truth.times):
        return
    names, mm = truth.setup.names, truth.setup.metres * 1000
    way = truth.setup.speed * mm * limits.reaction
    wrong = truth.error + way * np.minimum(truth.turned, 2.0)
    wrong = np.maximum.accumulate(wrong, axis=0) + NOISE_MM
    at = truth.poses[..., 0] + 1j * truth.poses[..., 1]
    then = at + way * np.exp(1j * truth.poses[..., 2])
    over = _over(truth, then)
    leaves = (over > wrong) & (over > _over(truth, at) + NOISE_MM)
    for i, name in enumerate(names):
        yield from _driven(truth, "drives out", name, leaves[:, i], (i,))
    for i, j in combinations(range(len(names)), 2):
        now, later = np.abs(at[:, i] - at[:, j]), np.abs(then[:, i] - then[:, j])
        near = limits.separation_mm - wrong[:, i] - wrong[:, j]
        meets = (np.minimum(now, later) < near) & (later < now - NOISE_MM)
        yield from _driven(truth, "drives together", f"{names[i]}, {names[j]}", meets, (i, j))


def _over(truth: Truth, at: NDArray[np.complex128]) -> Floats:
    """Return how far points are outside the arena [mm]; 0 inside."""
    arena, mm = truth.setup.arena, truth.setup.metres * 1000
    x, y = at.real / mm, at.imag / mm
    beyond_x = np.maximum(np.maximum(arena.left - x, x - arena.right), 0.0)
    return np.hypot(beyond_x, np.maximum(np.maximum(arena.bottom - y, y - arena.top), 0.0)) * mm


def _driven(
    truth: Truth, name: str, found: str, wrong: Bools, robots: tuple[int, ...]
) -> Iterator[Violation]:
    """Yield the first command that drives one of the `robots` ahead though it has been `wrong` (T,)
    for longer than a slack at the newest exposure at which all of them were shown.
    """
    if not wrong.any():
        return
    first = np.maximum.accumulate(np.where(wrong, -1, np.arange(len(wrong))))  # last row not wrong
    ahead = np.array([[drives for _, drives, _ in truth.sent(i)] for i in robots])
    for command, drives in zip(truth.of("command"), ahead.T, strict=True):
        at, unseen = command["t_ns"] / 1e9, [command["unseen_ms"][i] / 1000 for i in robots]
        row = int(np.searchsorted(truth.times, at - max(unseen) + 1e-3)) - 1
        if not drives.any() or row < 0 or max(unseen) - min(unseen) > UNTRACKED_STOP_S:
            continue
        if truth.times[row] - truth.times[first[row]] > SLACK_S + 0.01 and wrong[row]:
            yield Violation(name, at, found)
            return
