"""Random control problems without obstacles, with the best plans that an optimiser finds."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from tetractl.core.poses import Observation
from tetractl.run.checked_controller import build_controller
from tetractl.spec.experiment import Experiment
from tetractl.spec.load import parse_spec


def spec(
    rng: np.random.Generator,
    robots: int,
    signals: int,
    motion: str = "exact",
    kind: str = "",
    obstacles: Sequence[dict[str, object]] = (),
) -> Experiment:
    """Robots with random starts, targets and speeds; `kind` says how a and headings differ."""
    kind = kind or str(rng.choice(["equal", "near", "turned", "apart"]))
    a = np.full(robots, rng.uniform(1, 7))
    heading = np.full(robots, rng.uniform(-3, 3))
    if kind == "near":
        a *= rng.uniform(0.97, 1.03, robots)
    elif kind == "turned":
        heading += rng.uniform(-0.3, 0.3, robots)
    elif kind == "apart":
        a = rng.uniform(1, 7, robots)
    places = rng.uniform(100, 900, (robots, 4)).round(1).tolist()
    listed = [
        {
            "name": f"r{i}",
            "start": places[i][:2],
            "target": places[i][2:],
            "heading": float(heading[i]),
            "a": float(a[i]),
            "speed": float(rng.uniform(80, 250)),
        }
        for i in range(robots)
    ]
    controller = {
        "type": "mpc",
        "period": 0.2,
        "motion": motion,
        "horizon_max": signals,
        "collision": {"walls": bool(obstacles)},
        "optimizer": {"type": "multistart", "rounds": 3},
    }
    arena = {"left": 0, "bottom": 0, "width": 1000, "height": 1000}
    text = {"name": "bounded", "arena": arena, "robots": listed, "controller": controller}
    return parse_spec(json.dumps({**text, "obstacles": list(obstacles)}), "bounded").experiment


def shapes(obstacles: Sequence[dict[str, object]]) -> tuple[Any, ...]:
    """Obstacles of a spec, in an arena so large that no robot stands in one."""
    arena = {"left": -1e4, "bottom": -1e4, "width": 2e4, "height": 2e4}
    robot = {"name": "r", "start": [-9e3, -9e3], "target": [-9e3, -9e3], "a": 1, "speed": 1}
    text = {"name": "shapes", "arena": arena, "robots": [robot], "obstacles": list(obstacles)}
    return tuple(parse_spec(json.dumps(text), "shapes").experiment.setup.obstacles)


def seconds_of(experiment: Experiment) -> float:
    """The longest time a plan of the first step takes [s]."""
    return experiment.controller.horizon_max * experiment.controller.period


def best_plan(experiment: Experiment) -> float:
    """The least predicted cost J of all plans of the first step."""
    everyone = np.ones(len(experiment.robots), dtype=np.bool_)
    observation = Observation(0, 0, 0, experiment.setup.starts, everyone)
    return build_controller(experiment, key=1).plan(observation).cost
