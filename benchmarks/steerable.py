"""Compare the verdict of `analyze` and `validate`, what the signal can reach, with the plant.

    python benchmarks/steerable.py                 200 sets, about a minute
    python benchmarks/steerable.py --sets 20

Draws sets of 1 to 6 robots, moved by the plant's three motions in short steps, half of them near
the border: two robots differ so little that a combination of their ends is within a factor 3 of the
tolerance. The plant drives each set under 1,000 random sequences; the rank of the differences of
its ends says what can be reached, and which robots move alike; sequences that part nearly equal
robots by chance, beyond 4 deviations by quartiles, count as that much. Nothing is shared with
`tetractl.analysis`. A verdict is right if rank and names agree, or, where the plant's value is
within a factor 3 of the tolerance, if it says "barely" or has the same rank. What is advised to
part robots is tried in the plant.
"""

import argparse
import math
from dataclasses import dataclass, replace
from itertools import combinations
from time import process_time

import numpy as np

from tetractl.analysis.reach import reach_of
from tetractl.core.commands import Steer
from tetractl.core.poses import Poses
from tetractl.core.registries import MOTIONS
from tetractl.core.setup import Bounds, Setup
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.plant.direct import DirectDrive

SIGNALS = 96
TRIALS = 1000
LEAST = 0.01
BAND = 3.0
KINDS = "exact", "euler", "arc"
LN_A = math.log(2), math.log(8)  # a is drawn between these [rad/s]
LN_NEAR = math.log(1e-4), math.log(2e-2)  # by which two robots near the border differ, relative


@dataclass
class Seen:
    """What the plant shows: relative values, and pairs that move alike, surely and perhaps."""

    values: np.ndarray
    alike: set
    unsure: set

    @property
    def rank(self):
        return int((self.values >= LEAST).sum())

    @property
    def near(self):
        return bool(((self.values > LEAST / BAND) & (self.values < LEAST * BAND)).any())


def ends(setup, motion, seed):
    """Return the ends (TRIALS, N, 2), over the speed, to which the plant drives the robots."""
    rng = np.random.default_rng(seed)
    count = len(setup.a)
    held_s = 1 / math.exp(sum(map(math.log, setup.a)) / count)
    parts = 1 if motion == "exact" else math.ceil(4 * max(setup.a) * held_s)
    all_ends = np.zeros((3, TRIALS, count))
    all_ends[2] = setup.starts.heading
    starts = Poses(*all_ends.reshape(3, -1))
    speed = np.tile(setup.speed > 0, TRIALS) * 1.0
    drive = DirectDrive(MOTIONS.load(motion), np.tile(setup.a, TRIALS), speed, starts)
    reached = np.ones(speed.size, dtype=bool)
    part_ns = np.array([round(1e9 * held_s / parts)])
    for _ in range(SIGNALS):
        u = np.repeat(rng.uniform(-math.pi, math.pi, TRIALS), count)
        for _ in range(parts):
            drive.apply(DelayedCommand(0, 0, Steer(u), reached, headings=drive.poses.heading))
            drive.advance(0, part_ns, np.array([True]))
    return drive.poses.xy.reshape(TRIALS, count, 2)


def judged(setup, motion, seed):
    """Return what differences of the plant's ends show."""
    end_poses = ends(setup, motion, seed)
    off = end_poses - end_poses.mean(axis=0)

    def values(robots):
        rows = parts_of_robots = off[:, robots].reshape(TRIALS, -1)
        for _ in range(6):
            _, value, axes = np.linalg.svd(parts_of_robots, full_matrices=False)
            parts = rows @ axes.T
            usual = (np.quantile(parts, 0.75, axis=0) - np.quantile(parts, 0.25, axis=0)) / 1.349
            parts_of_robots = np.clip(parts, -4 * usual, 4 * usual) @ axes
        return value / math.sqrt(TRIALS)

    whole_reach = values(range(len(setup.a)))
    least = {
        pair: values(pair)[-1] / whole_reach[0]
        for pair in combinations(np.flatnonzero(setup.speed).tolist(), 2)
    }
    alike = {pair for pair, reach in least.items() if reach < LEAST / BAND}
    return Seen(
        whole_reach / whole_reach[0],
        alike,
        {p for p, reach in least.items() if reach < LEAST * BAND} - alike,
    )


def drawn(rng, near):
    """Return a random set of robots and its motion; `near`: two differ by very little."""
    count = int(rng.integers(2 if near else 1, 7))
    a = np.exp(rng.uniform(*LN_A, count))
    speed = rng.uniform(50, 400, count)
    heading = rng.uniform(-math.pi, math.pi, count)
    kind = rng.integers(4)
    members = rng.permutation(count)[: int(rng.integers(2, count + 1))] if count > 1 else []
    if near:
        i, j = members[:2]
        by = math.exp(rng.uniform(*LN_NEAR))
        turn = by * rng.choice([-1, 1])
        a[j], heading[j] = (a[i] * (1 + by), heading[i]) if kind < 2 else (a[i], heading[i] + turn)
    elif kind < 2:
        a[members] = a[members[:1]]
        heading[members] = heading[members[:1]]
    elif kind == 2 and count > 1:
        speed[members[:1]] = 0.0
    return setup_of(a, speed, heading), str(rng.choice(KINDS))


def setup_of(a, speed, heading):
    """Return robots with these values."""
    count = len(a)
    names = tuple(f"r{i}" for i in range(count))
    starts = Poses(np.zeros(count), np.zeros(count), heading)
    return Setup(
        "drawn", "mm", 1e-3, names, (None,) * count, starts, np.zeros((count, 2)), a, speed,
        Bounds(-1e3, -1e3, 1e3, 1e3), (), 0.1, 1e6, 1, None,
    )  # fmt: skip


def right(setup, motion, verdict, judged_at, seed):
    """Return whether a verdict agrees with the plant, and its advice with what it does."""
    same = verdict.rank == judged_at.rank
    said = set()
    for group in verdict.alike:
        indices = sorted(setup.names.index(name) for name in group)
        said |= set(combinations(indices, 2))
    named = judged_at.alike <= said <= judged_at.alike | judged_at.unsure
    still = {setup.names[i] for i in np.flatnonzero(setup.speed == 0)} == set(verdict.still)
    good = (same or (judged_at.near and verdict.barely > 0)) and named and still
    a = setup.a.copy()
    for robot in verdict.parted:
        a[setup.names.index(robot.name)] = robot.a_advised
    if verdict.parted:
        good &= not said & judged(replace(setup, a=a), motion, seed).alike
    return good, same, judged_at.near, verdict.barely > 0


def main(sets, seed):
    """Print the table."""
    rng = np.random.default_rng(seed)
    rows = []
    seconds = 0.0
    while len(rows) < sets:
        near = len(rows) % 2 == 1
        setup, motion = drawn(rng, near)
        judged_at = judged(setup, motion, seed + len(rows))
        if judged_at.near != near:
            continue
        began = process_time()
        verdict = reach_of(setup, "exact")
        seconds = max(seconds, process_time() - began)
        rows.append(right(setup, motion, verdict, judged_at, seed + len(rows)))
        if not rows[-1][0]:
            print("wrong:", motion, setup.a, setup.speed, verdict, verdict.spread, judged_at)
    good, same, near, said = np.array(rows).T
    barely = near & said
    numbers = [sets, *(row.sum() for row in (good, same, near, barely))]
    print("| sets | right | same rank | near the border | said barely | longest, processor time |")
    print("|---|---|---|---|---|---|")
    print(f"| {' | '.join(map(str, numbers))} | {seconds:.2f} s |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sets", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    main(options.sets, options.seed)
