"""Measure robots that are to go from anywhere to anywhere, each to a target of its own.

    python benchmarks/anywhere.py                   50 random instances of 2 to 6 robots in the loop
    python benchmarks/anywhere.py --part many       first plans for many robots, undisturbed

Instance i has 2 + i mod 5 robots in 2.4 x 2.4 m: starts, headings and targets anywhere at least
150 mm from the edge and 250 mm from each other, one to three rectangles at least 200 mm from all of
them, a from 2 to 6 rad/s, speeds from 150 to 200 mm/s; walls and margins as in `three_m3pi.yaml`.
It is driven once, by the recommended controller, in the plant of `disturbed.py --part hurting`.
An instance is solved where the mean error of a robot is within 1 % of the arena, 24 mm. Its plans
while robots move have a deadline, 80 % of the control period, kept by the work of the searches; the
thread's processor time of these plans is printed too.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from disturbed import HURT, counted, run
from solverbench.problems import OURS
from solverbench.problems import experiment as load_experiment
from solverbench.report import load, progress

from tetractl.control.lengths import Searcher, least_length
from tetractl.control.mpc import Mpc
from tetractl.control.optimizers.multistart import Multistart
from tetractl.core.commands import Command
from tetractl.core.plan import End, Limits, Outcome, Plan, Problem, Search
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.protocols import Plant
from tetractl.core.trial import Result
from tetractl.experiment.experiment import Experiment
from tetractl.model.obstacles import Obstacles
from tetractl.results.estimate import percent, proportion_interval

ARENA_MM = 2400.0
EDGE_MM = 150.0
BETWEEN_MM = 250.0
CLEAR_MM = 200.0
SOLVED_MM = 0.01 * ARENA_MM  # a robot
ACCEPT_MM = 5.0  # a robot
CONTROLLER = ("controller.horizon_max=200", "controller.time_limit=160.05")
SIZES = (2, 3, 4, 5, 6)


def instance(number: int, seed: int) -> Experiment:
    """Return one random instance as an experiment."""
    rng = np.random.default_rng([seed, number])
    count = SIZES[number % len(SIZES)]
    starts = scattered(rng, count)
    targets = scattered(rng, count)
    base = load_experiment(OURS, *CONTROLLER, *HURT)
    data = base.model_dump(mode="json", exclude={"lab", "scale", "reference"})
    data["arena"] = {"left": 0, "bottom": 0, "width": ARENA_MM, "height": ARENA_MM}
    data["robots"] = robots(rng, starts, targets)
    data["obstacles"] = _obstacles(rng, np.vstack([starts, targets]))
    data["controller"]["accept_error"] = ACCEPT_MM * count
    data["trials"] = {"count": 1, "seed": seed + number}
    return Experiment.model_validate(data)


def robots(rng: np.random.Generator, starts: Floats, targets: Floats) -> tuple[dict[str, Any], ...]:
    """Return robots with any headings and any speeds, whose a are apart by one factor."""
    rates = rng.permutation(np.geomspace(2, 6, len(starts)))
    return tuple(
        {
            "name": f"r{i}",
            "start": tuple(starts[i]),
            "heading": float(rng.uniform(-np.pi, np.pi)),
            "target": tuple(targets[i]),
            "a": float(a),
            "speed": float(rng.uniform(150, 200)),
        }
        for i, a in enumerate(rates)
    )


INSIDE = EDGE_MM, ARENA_MM - EDGE_MM


def scattered(
    rng: np.random.Generator,
    count: int,
    x: tuple[float, float] = INSIDE,
    y: tuple[float, float] = INSIDE,
) -> Floats:
    """Draw points (count, 2) within ranges of x and y that are BETWEEN_MM from each other."""
    points: list[Floats] = []
    while len(points) < count:
        point = rng.uniform(*zip(x, y, strict=True))
        if all(np.hypot(*(point - placed)) >= BETWEEN_MM for placed in points):
            points.append(point)
    return np.array(points)


def _obstacles(rng: np.random.Generator, points: Floats) -> tuple[dict[str, Any], ...]:
    """Draw one to three rectangles that are CLEAR_MM from all points."""
    obstacles: list[dict[str, Any]] = []
    several = int(rng.integers(1, 4))
    for _ in range(1000 * several):
        size = rng.uniform(150, 350, 2)
        corner = rng.uniform(0, ARENA_MM - size)
        off = np.maximum(np.maximum(corner - points, points - corner - size), 0.0)
        if np.hypot(*off.T).min() >= CLEAR_MM and len(obstacles) < several:
            x, y = corner.tolist()
            width, height = size.tolist()
            sizes = {"left": x, "bottom": y, "width": width, "height": height}
            obstacles.append({"type": "rectangle", **sizes})
    return tuple(obstacles)


class Timed(Mpc):
    """The controller, with the processor time of each plan for moving robots [s]."""

    seconds: list[float]

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        moved = self.progress.moving
        begin = time.thread_time()
        plan = super().plan(observation, last_command, earlier)
        if moved:
            self.seconds.append(time.thread_time() - begin)
        return plan


@dataclass(frozen=True)
class Driven:
    """What came of an instance; `plans_s` are the processor times of plans for moving robots."""

    count: int
    result: Result
    plans_s: list[float]

    @property
    def is_solved(self) -> bool:
        return self.result.total_error <= SOLVED_MM * self.count

    @property
    def is_unsafe(self) -> bool:
        return bool(self.result.entered_obstacle or self.result.left_arena)


def drive_once(spec: Experiment) -> Driven:
    plans_s: list[float] = []

    def build(spec: Experiment, key: int, plant: Plant) -> Timed:
        controller = counted(Timed, spec.controller, spec.setup, key)
        controller.seconds = plans_s
        return controller

    (result,) = run(spec, 1, build)
    return Driven(len(spec.robots), result, plans_s)


def drive(numbers: range, seed: int) -> None:
    """Drive every instance once, and print a row for each number of robots."""
    all_driven = []
    for number in numbers:
        progress(f"instance {number}")
        driven = drive_once(instance(number, seed))
        all_driven.append(driven)
        result = driven.result
        times_ms = 1e3 * np.array(driven.plans_s or [0.0])
        print(
            f"<!-- {number}: {driven.count} robots, "
            f"{result.total_error / driven.count:.1f} mm a robot, "
            f"{result.duration_s:.0f} s, {result.outcome.value}; plans {times_ms.mean():.1f} ms, "
            f"p99 {np.quantile(times_ms, 0.99):.0f}, max {times_ms.max():.0f} -->",
            flush=True,
        )
    print_rows(all_driven)


def print_rows(all_driven: Sequence[Driven]) -> None:
    """Print what came of the instances of each size, and of all."""
    print("\n| robots | solved | 95 % interval of the share | plan, mean / p99 / max [ms] |")
    print("|---|---|---|---|")
    for size in SIZES:
        print(row(f"{size}", [driven for driven in all_driven if driven.count == size]))
    print(row("all", all_driven))
    unsafe = sum(driven.is_unsafe for driven in all_driven)
    print(f"\n{unsafe} of {len(all_driven)} entered an obstacle or left the arena.")


def row(name: str, all_driven: Sequence[Driven]) -> str:
    solved = sum(driven.is_solved for driven in all_driven)
    interval = proportion_interval(solved, len(all_driven))
    share = percent(interval).strip(" ()")
    plans_ms = [1e3 * plan_s for driven in all_driven for plan_s in driven.plans_s]
    times = ""
    if plans_ms:
        p99 = np.quantile(plans_ms, 0.99)
        times = f"{np.mean(plans_ms):.1f} / {p99:.1f} / {max(plans_ms):.1f}"
    return f"| {name} | {solved} of {len(all_driven)} | {share} | {times} |"


def many(robots: int, seed: int) -> Problem:
    """Robots anywhere in 2 x 2 m; 1 m in one direction for all, and each 0.2 m or so by itself."""
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
        obstacles=Obstacles.of(),
        obstacle_weight=1000.0,
        swept=False,
    )


def good(search: Search) -> bool:
    """Whether a sequence ends at the targets."""
    return search.cost <= Multistart().tolerance


def first_plans(trials: int) -> None:
    """First plans for many robots, each an instance of its own, up to 80 s long."""
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
                searcher = Searcher(optimizer, problem, seed)
                searcher.spread(least_length(problem), 400, good)
                seconds.append(time.thread_time() - begin)
                best = min(searcher.found, key=lambda way: (not good(way), way.length))
                solved += best.cost <= 1
                signals.append(best.length)
            p50, p95 = np.quantile(seconds, [0.5, 0.95])
            cells = robots, name, f"{solved} of {trials}", f"{np.median(signals):.0f}"
            print(f"| {' | '.join(map(str, cells))} | {p50:.2f} / {p95:.2f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--part", choices=("drive", "many"), default="drive")
    parser.add_argument("--trials", type=int, default=50, help="instances")
    parser.add_argument("--seed", type=int, default=6200)
    chosen = parser.parse_args()
    if chosen.part == "many":
        first_plans(chosen.trials)
        return
    print(f"Simulated, seed {chosen.seed}, {chosen.trials} instances. {load()}.\n")
    drive(range(chosen.trials), chosen.seed)


if __name__ == "__main__":
    main()
