"""Analyse how far one common signal can move the robots of a spec apart.

The analysis moves all N robots from their starts by SEQUENCE_COUNT random sequences of
SEQUENCE_LENGTH directions, sampled uniformly. Each direction is held for the time in which a robot
turns by about 60 degrees: 1 / a, with the geometric mean of the rates a. The *ends* of a sequence
are the robots' final displacements divided by their speeds, 2N numbers. The eigenvalues of the
covariance of the ends show how far each combination of ends can be moved: the *spread* of a
combination is the square root of its eigenvalue, relative to the largest square root. A combination
with a spread near 0 cannot be controlled.

If a sequence moves a combination by more than CHANCE_FACTOR times its usual spread, the motion is
clipped to this value. The reason: a direction that happens to be opposite to the heading of two
nearly equal robots separates them, but this is too rare to rely on. The rank is the number of
spreads of at least SPREAD_TOLERANCE. Two robots move identically if a combination of only these two
robots has a spread below SPREAD_TOLERANCE. The result depends neither on the controller nor on the
targets.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.core.registries import MOTIONS
from tetractl.core.setup import Setup
from tetractl.run.plausibility import OVERSHOOTING_MOTION
from tetractl.spec.experiment import Experiment
from tetractl.spec.section_abilities import Modelled

SEQUENCE_COUNT = 1000
"""Number of random sequences."""
SEQUENCE_LENGTH = 96
"""Number of directions in a sequence."""
SEED = 0
"""Seed of the sequences. It is fixed, so that a verdict does not depend on chance."""
SPREAD_TOLERANCE = 0.01
"""Minimum spread of a reachable combination, relative to the largest spread."""
CHANCE_FACTOR = 4.0
"""Multiple of a combination's usual spread beyond which a motion counts as chance."""
CLIPPING_ROUNDS = 4
"""Number of rounds in which motions by chance are found and clipped."""
NORMAL_MEDIAN = 0.6745
"""Median of the magnitudes of normal numbers, over their standard deviation."""
NEAR_FACTOR = 3.0
"""Factor around SPREAD_TOLERANCE within which a combination counts as barely reached."""
SPREAD_MIN_S = 1e-300
"""Minimum value by which spreads are divided [s].

If all robots stand still, the largest spread is 0.
"""
ROBOTS_MAX = 40
"""Maximum number of robots that are analysed. More would take longer than a second."""
RATE_CHANGES = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Relative changes of a turning rate a that are tried to separate identical robots."""


@dataclass(frozen=True, slots=True)
class SeparableRobot:
    """A robot that would move differently from its group if it had another turning rate.

    Attributes:
        robot: Name of the robot.
        a: Present turning rate of the robot [rad/s].
        a_advised: Turning rate with which the robot would move differently [rad/s].
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
        separable: Robots of these groups that another turning rate would separate from their group.
    """

    spread: Floats
    identical: tuple[tuple[str, ...], ...]
    still: tuple[str, ...]
    separable: tuple[SeparableRobot, ...]

    @property
    def rank(self) -> int:
        """The number of combinations of the robots' ends that the signal can move."""
        return int((self.spread >= SPREAD_TOLERANCE).sum())

    @property
    def barely(self) -> int:
        """The number of combinations that are barely reached.

        Their spread is within a factor NEAR_FACTOR of SPREAD_TOLERANCE.
        """
        return int(
            (
                (self.spread > SPREAD_TOLERANCE / NEAR_FACTOR)
                & (self.spread < SPREAD_TOLERANCE * NEAR_FACTOR)
            ).sum()
        )

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
        sentences = [f"{self.rank} of {len(self.spread)}{barely}"]
        separable_names = {separable.robot for separable in self.separable}
        for group in self.identical:
            sentence = f"{', '.join(group[:-1])} and {group[-1]} move in the same way"
            if separable_names.isdisjoint(group):
                sentence += (
                    ", and would do so even if their turning rates a differed by "
                    f"{100 * RATE_CHANGES[-1]:g} %"
                )
            sentences.append(sentence)
        for separable in self.separable:
            change = f"from {separable.a:.4g} to {separable.a_advised:.4g}"
            sentences.append(
                f"changing the turning rate a of {separable.robot} {change} separates them"
            )
        sentences += [f"{name} has speed 0" for name in self.still]
        return "; ".join(sentences)


def reach(experiment: Experiment) -> Reach | None:
    """Compute how far a spec's common signal can move its robots apart.

    The motion is the controller's. If it advances headings by the paper's equation (6), which
    approximates the exact motion, the exact motion is used instead. The result is None for more
    than ROBOTS_MAX robots, and for robots that a trial still has to find.
    """
    setup = experiment.setup
    control = experiment.controller
    if experiment.must_choose_robots or len(setup.names) > ROBOTS_MAX:
        return None
    motion = control.motion if isinstance(control, Modelled) else "exact"
    return analyse_reach(setup, "exact" if motion == OVERSHOOTING_MOTION else motion)


def analyse_reach(setup: Setup, motion: str) -> Reach:
    """Compute how far the common signal can move the robots of a setup apart."""
    moves = setup.speed > 0
    ends = _sample_ends(setup, motion)
    spread = _spreads(ends)
    spread_max = max(float(spread[0]), SPREAD_MIN_S)
    identical: list[tuple[str, ...]] = []
    separable: list[SeparableRobot] = []
    for group in _identical_groups(ends, moves, SPREAD_TOLERANCE * spread_max):
        identical.append(tuple(setup.names[robot] for robot in group))
        separable += _separable_robots(setup, motion, group, spread_max)
    return Reach(
        spread=spread / spread_max,
        identical=tuple(identical),
        still=tuple(setup.names[robot] for robot in np.flatnonzero(~moves)),
        separable=tuple(separable),
    )


def _sample_ends(setup: Setup, motion: str) -> Floats:
    """Compute the final displacements of the robots under random directions, minus their mean.

    Every moving robot has speed 1, so lengths are in seconds. The shape is (SEQUENCE_COUNT, 2N),
    with x and y of each robot in turn.
    """
    step = MOTIONS.load(motion).step
    speed = np.where(setup.speed > 0, 1.0, 0.0)
    mean_log_a = np.log(setup.a).mean()
    mean_turn_s = float(np.exp(-mean_log_a))
    held_s = min(mean_turn_s, setup.time_limit_s / SEQUENCE_LENGTH)
    shape = (SEQUENCE_COUNT, len(speed))
    x = np.zeros(shape)
    y = np.zeros(shape)
    heading = np.broadcast_to(setup.starts.heading, shape)
    rng = np.random.default_rng(SEED)
    for _ in range(SEQUENCE_LENGTH):
        directions = rng.uniform(-np.pi, np.pi, (SEQUENCE_COUNT, 1))
        x, y, heading = step(x, y, heading, directions, setup.a, speed, held_s)
    ends = np.stack([x, y], axis=-1).reshape(SEQUENCE_COUNT, -1)
    return ends - ends.mean(axis=0)


def _spreads(ends: Floats) -> Floats:
    """Compute how far each combination of coordinates spreads [s], in descending order.

    The combinations are the principal axes of the ends, of shape (SEQUENCE_COUNT, M), and the
    result has shape (M,). Far outliers count only up to a limit.
    """
    clipped_ends = ends
    values = np.zeros(ends.shape[1])
    for _ in range(CLIPPING_ROUNDS):
        values, axes = np.linalg.eigh(clipped_ends.T @ clipped_ends / len(ends))
        coordinates = ends @ axes
        limit = CHANCE_FACTOR * np.median(np.abs(coordinates), axis=0) / NORMAL_MEDIAN
        clipped_ends = np.clip(coordinates, -limit, limit) @ axes.T
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


def _spread_between(ends: Floats, robot: int, other: int) -> float:
    """Compute the smallest spread of any combination of two robots' ends [s]."""
    columns = [2 * robot, 2 * robot + 1, 2 * other, 2 * other + 1]
    return float(_spreads(ends[:, columns])[-1])


def _separable_robots(
    setup: Setup, motion: str, group: list[int], spread_max: float
) -> Iterator[SeparableRobot]:
    """Yield the robots of a group except the first, each with a turning rate that separates it.

    The rates follow from the first of RATE_CHANGES that separates all robots of the group. Nothing
    is yielded if no change separates them.
    """
    a = setup.a.copy()
    spread_min = NEAR_FACTOR * SPREAD_TOLERANCE * spread_max
    for rate_change in RATE_CHANGES:
        a[group[1:]] = setup.a[group[0]] * (1 + rate_change) ** np.arange(1, len(group))
        ends = _sample_ends(replace(setup.select_robots(group), a=a[group]), motion)
        pairs = combinations(range(len(group)), 2)
        if all(_spread_between(ends, robot_i, robot_j) > spread_min for robot_i, robot_j in pairs):
            for robot in group[1:]:
                yield SeparableRobot(setup.names[robot], float(setup.a[robot]), float(a[robot]))
            return
