"""Analyse how far one common signal can move the robots of a spec apart.

The analysis moves all N robots from their starts by SEQUENCES random sequences of LENGTH
directions, sampled uniformly. Each direction is held for the time in which a robot turns by about
60 degrees: 1 / a, with the geometric mean of the rates a. The *ends* of a sequence are the robots'
final displacements divided by their speeds, 2N numbers. The eigenvalues of the covariance of the
ends show how far each combination of ends can be moved: the *spread* of a combination is the square
root of its eigenvalue, relative to the largest one. A combination with a spread near 0 cannot be
controlled.

If a sequence moves a combination by more than CHANCE times its usual spread, it is counted as that
much. The reason: a direction that happens to be opposite to the heading of two nearly equal robots
separates them, but this is too rare to rely on. The rank is the number of spreads of at least
TOLERANCE. Two robots move identically if a combination of these two alone is below TOLERANCE. The
result depends neither on the controller nor on the targets.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.core.registries import MOTIONS
from tetractl.core.setup import Setup
from tetractl.run.plausibility import OVERSHOOTING
from tetractl.spec.experiment import Experiment
from tetractl.spec.section_abilities import Modelled

SEQUENCES = 1000
"""Number of random sequences."""
LENGTH = 96
"""Number of directions in a sequence."""
SEED = 0
"""Seed of the sequences. It is fixed, so that a verdict does not depend on chance."""
TOLERANCE = 0.01
"""Minimum spread of a reachable combination, relative to that of the one that moves furthest."""
CHANCE = 4.0
"""Multiple of the usual spread of a combination beyond which a sequence has moved it by chance."""
ROUNDS = 4
"""Number of rounds in which sequences that moved a combination by chance are found."""
NORMAL_MEDIAN = 0.6745
"""Median of the magnitudes of normal numbers, over their standard deviation."""
NEAR = 3.0
"""Factor around TOLERANCE within which a combination counts as barely reached."""
STILL = 1e-300
"""Minimum value by which spreads are divided [s].

If all robots stand still, the largest spread is 0.
"""
ROBOTS_MAX = 40
"""Maximum number of robots that are analysed. More would take longer than a second."""
STEPS = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Relative differences of a that are tried to make identical robots move differently."""


@dataclass(frozen=True, slots=True)
class PartedRobot:
    """A robot that would move differently from its group if it had another turning rate.

    Attributes:
        robot: The robot.
        a: Its turning rate [rad/s].
        a_advised: The turning rate at which it would move differently [rad/s].
    """

    robot: str
    a: float
    a_advised: float


@dataclass(frozen=True, slots=True)
class Reach:
    """How far the common signal can move the robots of a spec apart.

    Attributes:
        spread: Relative spread of each combination of the robots' ends, shape (2N,), descending. A
            combination with a spread near 0 cannot be controlled.
        identical: Groups of robots that move identically, by their names.
        still: Names of the robots that do not move.
        separable: Robots of these groups that another turning rate would separate from the others.
    """

    spread: Floats
    identical: tuple[tuple[str, ...], ...]
    still: tuple[str, ...]
    separable: tuple[PartedRobot, ...]

    @property
    def rank(self) -> int:
        """The number of combinations of the robots' ends that the signal can move."""
        return int((self.spread >= TOLERANCE).sum())

    @property
    def barely(self) -> int:
        """The number of combinations whose spread is within a factor NEAR of TOLERANCE."""
        return int(((self.spread > TOLERANCE / NEAR) & (self.spread < TOLERANCE * NEAR)).sum())

    @property
    def fields(self) -> dict[str, Any]:
        """The result as the items of a JSON object: what one common signal can reach."""
        return {
            "rank": self.rank,
            "of": len(self.spread),
            "barely": self.barely,
            "alike": list(self.identical),
            "still": list(self.still),
            "parted": list(map(asdict, self.separable)),
            "spread": self.spread.tolist(),
        }

    def __str__(self) -> str:
        barely = f", {self.barely} of them barely" if self.barely else ""
        texts = [f"{self.rank} of {len(self.spread)}{barely}"]
        parted = {parting.robot for parting in self.separable}
        for group in self.identical:
            text = f"{', '.join(group[:-1])} and {group[-1]} move in the same way"
            if parted.isdisjoint(group):
                text += f", and still would if their a differed by {100 * STEPS[-1]:g} %"
            texts.append(text)
        for parting in self.separable:
            change = f"from {parting.a:.4g} to {parting.a_advised:.4g}"
            texts.append(f"a change of the a of {parting.robot} {change} would separate them")
        texts += [f"{name} has speed 0" for name in self.still]
        return "; ".join(texts)


def reach(experiment: Experiment) -> Reach | None:
    """Compute how far a spec's common signal can move its robots apart.

    The motion is the controller's. If it advances headings by the paper's equation (6), which
    approximates the exact motion, the exact motion is used instead. The result is None for more
    than ROBOTS_MAX robots, and for robots that a trial still has to find.
    """
    setup = experiment.setup
    control = experiment.controller
    if experiment.open or len(setup.names) > ROBOTS_MAX:
        return None
    motion = control.motion if isinstance(control, Modelled) else "exact"
    return reach_of(setup, "exact" if motion == OVERSHOOTING else motion)


def reach_of(setup: Setup, motion: str) -> Reach:
    """Compute how far the common signal can move the robots of a setup apart."""
    moves = setup.speed > 0
    ends = _ends(setup, motion)
    spread = _spreads(ends)
    spread_max = max(float(spread[0]), STILL)
    alike: list[tuple[str, ...]] = []
    parted: list[PartedRobot] = []
    for group in _identical_groups(ends, moves, TOLERANCE * spread_max):
        alike.append(tuple(setup.names[robot] for robot in group))
        parted += _separable_robots(setup, motion, group, spread_max)
    return Reach(
        spread=spread / spread_max,
        identical=tuple(alike),
        still=tuple(setup.names[robot] for robot in np.flatnonzero(~moves)),
        separable=tuple(parted),
    )


def _ends(setup: Setup, motion: str) -> Floats:
    """Compute where the robots end under random directions, relative to the mean end.

    Every moving robot has speed 1, so lengths are in seconds. The shape is (SEQUENCES, 2N),
    with x and y of each robot in turn.
    """
    step = MOTIONS.load(motion).step
    speed = np.where(setup.speed > 0, 1.0, 0.0)
    mean_log_a = np.log(setup.a).mean()
    mean_turn_s = float(np.exp(-mean_log_a))
    held_s = min(mean_turn_s, setup.time_limit_s / LENGTH)
    shape = (SEQUENCES, len(speed))
    x = np.zeros(shape)
    y = np.zeros(shape)
    heading = np.broadcast_to(setup.starts.heading, shape)
    random = np.random.default_rng(SEED)
    for _ in range(LENGTH):
        u = random.uniform(-np.pi, np.pi, (SEQUENCES, 1))
        x, y, heading = step(x, y, heading, u, setup.a, speed, held_s)
    ends = np.stack([x, y], axis=-1).reshape(SEQUENCES, -1)
    return ends - ends.mean(axis=0)


def _spreads(ends: Floats) -> Floats:
    """Compute how far each combination of coordinates spreads [s], in descending order.

    The combinations are the principal axes of the ends, of shape (SEQUENCES, M), and the
    result has shape (M,). Far outliers count only up to a limit.
    """
    counted = ends
    values = np.zeros(ends.shape[1])
    for _ in range(ROUNDS):
        values, axes = np.linalg.eigh(counted.T @ counted / len(ends))
        moved = ends @ axes
        limit = CHANCE * np.median(np.abs(moved), axis=0) / NORMAL_MEDIAN
        counted = np.clip(moved, -limit, limit) @ axes.T
    return np.sqrt(np.maximum(values[::-1], 0.0))


def _identical_groups(ends: Floats, moves: Bools, spread_min: float) -> Iterator[list[int]]:
    """Yield each group of at least two moving robots that the signal cannot move apart.

    Each robot of a group has a combination with another one that spreads less than
    `spread_min` [s]. The indices in a group are sorted.
    """
    ungrouped = set(np.flatnonzero(moves).tolist())
    while ungrouped:
        group = [min(ungrouped)]
        ungrouped.remove(group[0])
        for robot in group:  # grows while it is gone through
            for candidate in sorted(ungrouped):
                if _spread_between(ends, robot, candidate) < spread_min:
                    ungrouped.remove(candidate)
                    group.append(candidate)
        if len(group) > 1:
            yield sorted(group)


def _spread_between(ends: Floats, first: int, second: int) -> float:
    """Compute the smallest spread of any combination of two robots' ends [s]."""
    columns = [2 * first, 2 * first + 1, 2 * second, 2 * second + 1]
    return float(_spreads(ends[:, columns])[-1])


def _separable_robots(
    setup: Setup, motion: str, group: list[int], spread_max: float
) -> Iterator[PartedRobot]:
    """Yield the robots of a group except the first, each with a turning rate that separates it.

    It is the first one of STEPS that separates all robots of the group. Nothing is yielded if
    none does.
    """
    a = setup.a.copy()
    spread_min = NEAR * TOLERANCE * spread_max
    for step in STEPS:
        a[group[1:]] = setup.a[group[0]] * (1 + step) ** np.arange(1, len(group))
        ends = _ends(replace(setup.only(group), a=a[group]), motion)
        pairs = combinations(range(len(group)), 2)
        if all(_spread_between(ends, first, second) > spread_min for first, second in pairs):
            for robot in group[1:]:
                yield PartedRobot(setup.names[robot], float(setup.a[robot]), float(a[robot]))
            return
