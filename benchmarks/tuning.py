"""Tune the controllers that a paper or its references only describe: a grid over two parameters.

    python benchmarks/tuning.py ensemble          nine settings, 20 seeds each
    python benchmarks/tuning.py rrt --worlds 50   more seeds

Every setting drives with the same seeds (starts and targets drawn at random, the disturbances'
seeds), and every controller gets as many settings: equal budgets. Everything is simulated, with
heading walk 0.05 rad/sqrt(s), a and speed +-5 %, 1 mm and 0.01 rad of measurement noise.
"""

import argparse
import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from disturbed import run
from solverbench.problems import OURS
from solverbench.problems import experiment as load_experiment
from solverbench.report import progress

from tetractl.experiment.experiment import Experiment
from tetractl.results.estimate import distributions

PLANT = {
    "type": "sim",
    "heading_noise": 0.05,
    "a_error": 0.05,
    "speed_error": 0.05,
    "measurement_noise": {"position": 1.0, "heading": 0.01},
}
SEED, INSET = 5, 150.0


@dataclass(frozen=True)
class Study:
    """A controller, how many robots it gets, what it is given anyway, and the grid."""

    robots: int
    obstacles: bool
    given: dict[str, Any]
    grid: dict[str, tuple[float, ...]] = field(default_factory=dict)


STUDIES = {
    "ensemble": Study(
        robots=3,
        obstacles=False,
        given={"time_limit": 200.2},
        grid={"rate": (0.7, 1.3, 2.0), "fall": (0.05, 0.1, 0.3)},
    ),
    "rrt": Study(
        robots=1,
        obstacles=True,
        given={"time_limit": 200.2, "margin": 60.0},
        grid={"edge": (2.0, 4.0, 8.0), "reach": (1.0, 1.5, 2.5)},
    ),
}


def world(base: dict[str, Any], study: Study, controller: dict[str, Any], i: int) -> Experiment:
    """Return realisation i with a controller."""
    rng = np.random.default_rng([SEED, i])
    arena, robots = base["arena"], []
    obstacles = base["obstacles"] if study.obstacles else []
    for robot in base["robots"][: study.robots]:
        places = []
        while len(places) < 2:
            x, y = (
                float(rng.uniform(arena[low] + INSET, arena[low] + arena[size] - INSET))
                for low, size in (("left", "width"), ("bottom", "height"))
            )
            far = all(
                not (o["left"] - INSET <= x <= o["left"] + o["width"] + INSET)
                or not (o["bottom"] - INSET <= y <= o["bottom"] + o["height"] + INSET)
                for o in obstacles
            )
            if far:
                places.append((x, y))
        robots.append(robot | {"start": places[0], "target": places[1]})
    data = base | {
        "robots": tuple(robots),
        "obstacles": tuple(obstacles),
        "controller": controller,
        "plant": PLANT,
        "lab": None,
        "trials": {"count": 1, "seed": i},
    }
    return Experiment.model_validate(data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("controller", choices=STUDIES)
    parser.add_argument("--worlds", type=int, default=20)
    asked = parser.parse_args()
    study = STUDIES[asked.controller]
    base = load_experiment(OURS).model_dump(mode="json")
    head = (
        *study.grid,
        "total error [mm]",
        "its 95 % interval",
        "time [s]",
        "left the arena",
        "entered an obstacle",
    )
    print(f"| {' | '.join(head)} |")
    print("|" + "---|" * (len(head)))
    for values in itertools.product(*study.grid.values()):
        chosen = dict(zip(study.grid, values, strict=True))
        progress(f"{asked.controller} {chosen}")
        controller = {"type": asked.controller, "period": 0.2} | study.given | chosen
        results = [run(world(base, study, controller, i), 1)[0] for i in range(asked.worlds)]
        totals = np.array([result.total_error for result in results])
        (errors,) = distributions(totals[None])
        seconds = np.mean([result.duration_s for result in results])
        left = sum(min(result.verdict.edge) < 0 for result in results)
        entered = sum(result.entered_obstacle for result in results)
        cells = [
            *(f"{value:g}" for value in values),
            f"{errors.mean:.0f}",
            f"{errors.ci95.low:.0f} to {errors.ci95.high:.0f}",
        ]
        print(f"| {' | '.join(cells)} | {seconds:.0f} | {left} | {entered} |")
    print(f"\n{asked.worlds} seeds each, simulation with assumed disturbances.")


if __name__ == "__main__":
    main()
