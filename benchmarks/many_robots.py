"""Searches first plans for many robots without disturbances, for docs/reference/measured.md.

    python benchmarks/many_robots.py

The output is the section "Many robots". In rows with *grows*, the number of knots of a start and
the number of iterations of a polish grow with the number of robots.
"""

import argparse
import time

import numpy as np
from solverbench.report import describe_load

from tetractl.control.methods.lengths import Searcher, min_length
from tetractl.control.search.optimizers.multistart import Multistart
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Poses


def many(robots: int, seed: int) -> Problem:
    """Create a problem with robots anywhere in 2 x 2 m.

    The targets are 1 m away in one common direction, and about 0.2 m further in random directions.
    """
    rng = np.random.default_rng([robots, seed])
    speed = rng.uniform(150, 200, robots)
    starts = rng.uniform(0, 2000, (robots, 2))
    bearing = rng.uniform(-np.pi, np.pi)
    shift = 1000 * np.array([np.cos(bearing), np.sin(bearing)])
    return Problem(
        poses=Poses(*starts.T.copy(), np.zeros(robots)),
        targets=starts + shift + 200 * rng.standard_normal((robots, 2)),
        a=np.linspace(2, 6, robots),
        speed=speed,
        motion="exact",
        period=0.2,
        first_period=0.2,
        obstacles=Obstacles.from_shapes(),
        obstacle_weight=1000.0,
        swept=False,
    )


def good(search: Search) -> bool:
    """Check whether a sequence ends at the targets."""
    return search.cost <= Multistart().tolerance


def first_plans(trials: int) -> None:
    """Search first plans of up to 80 s for many robots, each for its own instance."""
    print("| robots | optimiser | solved to 1 mm | signals, median | first plan [s], p50 / p95 |")
    print("|---|---|---|---|---|")
    for robots in (3, 5, 8, 12, 16):
        for name, optimizer in (
            ("grows", Multistart(rounds=2)),
            ("does not", Multistart(rounds=2, grows=False)),
        ):
            optimizer.search(many(robots, trials), 10, None, 0, Limits())  # compile
            solved = 0
            signals = []
            seconds = []
            for seed in range(trials):
                problem = many(robots, seed)
                begin = time.thread_time()
                searcher = Searcher(optimizer, problem, seed, Limits())
                searcher.search_lengths(min_length(problem), 400, good)
                seconds.append(time.thread_time() - begin)
                best = min(searcher.searches, key=lambda way: (not good(way), way.length))
                solved += best.cost <= 1
                signals.append(best.length)
            p50, p95 = np.quantile(seconds, [0.5, 0.95])
            cells = robots, name, f"{solved} of {trials}", f"{np.median(signals):.0f}"
            print(f"| {' | '.join(map(str, cells))} | {p50:.2f} / {p95:.2f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--trials", type=int, default=50, help="instances")
    trials = parser.parse_args().trials
    print(f"{trials} instances of each number of robots. {describe_load()}.\n")
    first_plans(trials)


if __name__ == "__main__":
    main()
