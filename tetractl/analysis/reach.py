"""Which combinations of the robots' ends the common signal can move: can they be steered apart?

SEQUENCES sequences of LENGTH directions, drawn uniformly, move all N robots from their starts. Each
direction is held for the time in which a robot turns by some 60 degrees, 1/a by the geometric mean
of the rates a. Their ends, as displacements over the speed, are 2N numbers; the square roots of the
eigenvalues of their covariance, over the greatest, say how far each combination of ends can be
moved. A sequence that moves a combination by over CHANCE times its usual spread counts as that
much: nearly equal robots are parted so by a direction that happens to be opposite to their heading,
too rarely to be counted on. The rank is the number of spreads of at least TOLERANCE. Two robots
move alike if a combination of them alone is below it. Nothing of this depends on the controller or
on the targets.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.core.registries import MOTIONS
from tetractl.core.setup import Setup
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.section_abilities import Modelled
from tetractl.run.plausibility import OVERSHOOTING

SEQUENCES, LENGTH = 1000, 96
TOLERANCE = 0.01
"""Least spread of a combination that can be reached, over that of the one that moves furthest."""
CHANCE = 4.0
"""Multiple of the usual spread of a combination beyond which a sequence has moved it by chance."""
ROUNDS, QUARTILE = 4, 0.6745
NEAR = 3.0
"""Combinations within this factor of TOLERANCE are reached barely, if at all."""
ROBOTS_MAX = 40
"""Largest number of robots; more would take longer than a second."""
STEPS = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Relative differences of a that are tried to part robots."""


@dataclass(frozen=True, slots=True)
class Reach:
    """What the common signal can reach.

    `spread` (2N,) are the relative spreads of the combinations of ends, descending. `alike` are
    groups of robots that move alike, `still` robots that do not move; `parted` has a robot, its a
    and one with which it would not move like the others of its group.
    """

    spread: Floats
    alike: tuple[tuple[str, ...], ...]
    still: tuple[str, ...]
    parted: tuple[tuple[str, float, float], ...]

    @property
    def rank(self) -> int:
        """Number of combinations of ends that the signal can move."""
        return int((self.spread >= TOLERANCE).sum())

    @property
    def barely(self) -> int:
        """Number of combinations near the tolerance."""
        return int(((self.spread > TOLERANCE / NEAR) & (self.spread < TOLERANCE * NEAR)).sum())

    @property
    def fields(self) -> dict[str, Any]:
        """The items of a JSON object."""
        parted = [{"robot": name, "a": a, "a_advised": other} for name, a, other in self.parted]
        found = {"rank": self.rank, "of": len(self.spread), "barely": self.barely}
        moving = {"alike": list(self.alike), "still": list(self.still), "parted": parted}
        return found | moving | {"spread": self.spread.tolist()}

    def __str__(self) -> str:
        near = f", {self.barely} of them barely" if self.barely else ""
        text = f"{self.rank} of {len(self.spread)}{near}"
        for group in self.alike:
            text += f"; {', '.join(group[:-1])} and {group[-1]} move alike"
            if not {name for name, *_ in self.parted} & set(group):
                text += f" and would at an a that differs by {100 * STEPS[-1]:g} %"
        for name, a, other in self.parted:
            text += f"; a of {name} changed from {a:.4g} to {other:.4g} would part them"
        return text + "".join(f"; {name} has speed 0" for name in self.still)


def reach(experiment: Experiment) -> Reach | None:
    """Return what the signal of a spec can reach, by the motion of its controller; None for more
    than ROBOTS_MAX robots and for robots that a trial has still to find.

    The motions that advance headings by (6) approximate the exact one, which takes their place.
    """
    setup, control = experiment.setup, experiment.controller
    if experiment.open or len(setup.names) > ROBOTS_MAX:
        return None
    motion = control.motion if isinstance(control, Modelled) else "exact"
    return reach_of(setup, "exact" if motion in OVERSHOOTING else motion)


def reach_of(setup: Setup, motion: str) -> Reach:
    """Return what the signal can reach of the robots of a setup under a motion."""
    count, moves = len(setup.names), setup.speed > 0
    found = _ends(setup, motion)
    spread = _spreads(found)
    most = max(float(spread[0]), 1e-300)
    groups = list(_alike(found, moves, TOLERANCE * most))
    parted = [one for group in groups for one in _parted(setup, motion, group, most)]
    return Reach(
        spread=spread / most,
        alike=tuple(tuple(setup.names[i] for i in group) for group in groups),
        still=tuple(setup.names[i] for i in range(count) if not moves[i]),
        parted=tuple(parted),
    )


def _ends(setup: Setup, motion: str) -> Floats:
    """Return the ends (SEQUENCES, 2N) of random sequences, about their means [s]."""
    step, speed = MOTIONS.load(motion).step, (setup.speed > 0) * 1.0
    held = min(float(np.exp(-np.log(setup.a).mean())), setup.time_limit_s / LENGTH)
    shape = SEQUENCES, len(speed)
    x, y = np.zeros(shape), np.zeros(shape)
    heading = np.broadcast_to(setup.starts.heading, shape)
    random = np.random.default_rng(0)
    for _ in range(LENGTH):
        u = random.uniform(-np.pi, np.pi, (SEQUENCES, 1))
        x, y, heading = step(x, y, heading, u, setup.a, speed, held)
    ends = np.stack([x, y], axis=-1).reshape(SEQUENCES, -1)
    return ends - ends.mean(axis=0)


def _spreads(ends: Floats) -> Floats:
    """Return the spreads (M,) of the combinations of ends (SEQUENCES, M) [s], descending."""
    counted, values = ends, np.zeros(ends.shape[1])
    for _ in range(ROUNDS):
        values, axes = np.linalg.eigh(counted.T @ counted / len(ends))
        moved = ends @ axes
        most = CHANCE * np.median(np.abs(moved), axis=0) / QUARTILE
        counted = np.clip(moved, -most, most) @ axes.T
    return np.sqrt(np.maximum(values[::-1], 0.0))


def _alike(ends: Floats, moves: Bools, least: float) -> Iterator[list[int]]:
    """Yield groups of moving robots of which every one moves like another one of the group."""
    left = set(np.flatnonzero(moves).tolist())
    while left:
        group = [min(left)]
        left.remove(group[0])
        for i in group:
            near = [j for j in sorted(left) if _apart(ends, i, j) < least]
            left -= set(near)
            group += near
        if len(group) > 1:
            yield sorted(group)


def _apart(ends: Floats, i: int, j: int) -> float:
    """Return the least spread of a combination of two robots' ends [s]."""
    return float(_spreads(ends[:, [2 * i, 2 * i + 1, 2 * j, 2 * j + 1]])[-1])


def _parted(
    setup: Setup, motion: str, group: list[int], most: float
) -> Iterator[tuple[str, float, float]]:
    """Yield the robots of a group but the first with the least other a that parts them from it."""
    first, a = group[0], setup.a.copy()
    for step in STEPS:
        a[group[1:]] = setup.a[first] * (1 + step) ** np.arange(1, len(group))
        some = replace(setup.only(group), a=a[group])
        found = _ends(some, motion)
        if all(
            _apart(found, i, j) > NEAR * TOLERANCE * most
            for j in range(len(group))
            for i in range(j)
        ):
            for i in group[1:]:
                yield setup.names[i], float(setup.a[i]), float(a[i])
            return
