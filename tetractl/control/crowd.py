"""Ways for a crowd: robots so many that no sequence of directions found at random leads them near.

One direction moves all robots nearly alike; they come apart only because each turns at its own
rate. So some differences between the ways of robots take long, others are made at once. How long
shows the covariance of the robots' displacements under random directions, for a time of 1 s,

    C = E[ d d' ],  d (N, 2)        and       sqrt( g' (C + SURE^2 I)^-1 g ),  g (N, 2),

is how hard it is to bring robots to targets that are the gaps g away; its square is about the time
for which directions would have to be random (Mahalanobis, Proceedings of the National Institute of
Sciences of India 2, 1936). `nearer` searches a tree of directions for the least of it (beam search,
as in `tetractl.control.passage`): what is hard comes first, and what is easy can wait.

A sequence that leads eight robots to their targets takes half a minute and is useless a tenth of a
second later, since it passes by headings from which robots that hardly differ turn to opposite
sides. So only the next STAGE signals are searched, again at each signal, until the targets are so
easy to reach that a plan for the whole way can be followed.
"""

from collections.abc import Iterator

import numpy as np

from tetractl.control.branches import Tree
from tetractl.control.evaluate import compiled_branches
from tetractl.control.kernels import clearance
from tetractl.control.rng import uniform
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats

CROWD = 6  # least number of robots of a crowd
DEPTH_WEIGHT = 0.75  # of a depth relative to a miss, while a plan for the whole way is searched
DRAWN, WINDOW = 4000, 20  # numbers of random signals, and of those over which ways are compared
SURE = 0.18  # displacement that counts for none, in the way at the mean speed in 1 s
HELD = 2  # number of signals for which a branch is held
KEPT, STAGE_KEPT = 200, 50  # nodes kept of each level at rest, and while robots drive
LOOKED = 8  # of so many times that number, the best, the robots' distances are computed
ALIKE = 0.7  # nodes in the same squares are alike; their side in units of the largest v / a
STAGE = 10  # number of signals of a stage
NEAR = 12.0  # what is left, squared, from which plans for the whole way are searched [s]
EASY = 5.0  # what is left, squared, after signals from which an optimiser begins [s]
WHOLE = 80  # most signals of a plan for the whole way
LEFT = 3.0
"""What such a plan leaves in the end, if disturbed, in units of `accept_error`: the price of a
new one, and the error up to which one is followed from rest."""


def is_crowd(problem: Problem) -> bool:
    """Return whether robots are a crowd: so many, and without obstacles in their ways."""
    return len(problem.a) >= CROWD and not len(problem.obstacles.rows)


def ease(problem: Problem) -> Floats:
    """Return a factor E (N, N) such that |g' E| is how hard it is to bring robots to targets that
    are the gaps g (N, 2) away."""
    random = np.pi * (2 * uniform(1, 0, DRAWN) - 1)
    start = problem.poses.array()[None]
    way = compiled_branches(problem, start, np.zeros(1), random, problem.period)[:, 0, :, :2]
    moved = way[WINDOW:] - way[:-WINDOW]
    spread = np.einsum("mic,mjc->ij", moved, moved) / (len(moved) * WINDOW * problem.period)
    least = (SURE * float(problem.speed.mean())) ** 2
    return np.linalg.cholesky(np.linalg.inv(spread + least * np.eye(len(spread))))


def nearer(problem: Problem, most: int, key: int, kept: int) -> Iterator[tuple[Floats, float]]:
    """Yield sequences of 2, 4 and up to `most` signals after which the targets are easiest to
    reach, and the square of how hard it is then; `key` seeds the first direction of each level."""
    hard = ease(problem)
    tree = Tree(problem, key, HELD, ALIKE)
    walls = problem.obstacles.rows, problem.obstacles.walls
    for _ in range(most // HELD):
        path = tree.grow()
        x, y = np.moveaxis(path[..., :2], -1, 0).copy()
        gaps = np.empty((problem.obstacles.count, x.size))
        clearance.gaps(*walls, x.ravel(), y.ravel(), gaps)
        least = gaps.min(axis=0, initial=np.inf).reshape(x.shape).min(axis=(0, 2))
        gap = np.moveaxis(path[-1, ..., :2] - problem.targets, -1, -2)
        left = ((gap @ hard) ** 2).sum(axis=(1, 2))
        order = np.argsort(left, kind="stable")
        best = tree.unlike(order[least[order] > 0])[: LOOKED * kept]
        best = best[tree.apart(x[:, best], y[:, best])][:kept]
        if not len(best):
            return
        tree.keep(best)
        yield tree.sequence(0), float(left[best[0]])


def whole(problem: Problem, most: int, key: int) -> Iterator[Floats]:
    """Yield sequences of up to `most` signals after which an optimiser finds plans that bring a
    crowd to its targets."""
    return (
        signals for signals, left in nearer(problem, min(most, WHOLE), key, KEPT) if left < EASY
    )


def stage(problem: Problem, most: int, key: int, kept: int) -> tuple[Floats, float]:
    """Return the signals (L,) of the next stage, and the square of how hard it is after them; none,
    and inf, if robots cannot keep clear. `kept` is the number of nodes of each level."""
    *_, found = (np.empty(0), np.inf), *nearer(problem, min(STAGE, max(most, HELD)), key, kept)
    return found
