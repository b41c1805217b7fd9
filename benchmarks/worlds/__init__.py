"""The plants and layouts (*worlds*) in which the controller is measured.

A world is a spec of experiments/ with disturbances. Unless it says otherwise, it has the robots of
three_m3pi.yaml at 20 Hz in the plant `HURT`: dead time 0.11 s, a +-20 %, speed +-10 %, heading walk
0.03 rad/sqrt(s), 8 % of the commands lost, and a camera with 0.3 mm and 4 mrad at 120 Hz. Each
world adds one effect.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from solverbench.problems import OURS, PAPER, experiment

from tetractl.spec.experiment import Experiment

from .disturbances import UnmodelledSection
from .layouts import Random, anywhere, eight, near_a_wall, through_a_gap

BENCH = "three_m3pi_bench.yaml"
CELLS = "tetrahymena_disturbed.yaml"
BENCHMARK = (
    "near-equal",
    "five-robots",
    "paper-disturbed",
    "one-cell",
    "round-obstacle",
    "narrow-gap",
)
HURT = (
    "plant.dead_time=0.11",
    "plant.a_error=0.2",
    "plant.speed_error=0.1",
    "plant.heading_noise=0.03",
    "plant.lost_commands=0.08",
    "plant.measurement_noise={position: 0.3, heading: 0.004}",
)
SLOW_STACK = (  # control at 10 Hz, a slow camera that jitters, and a radio that loses much
    "plant.dead_time=0.15",
    "plant.a_error=0.2",
    "plant.speed_error=0.1",
    "plant.heading_noise=0.03",
    "plant.lost_commands=0.15",
    "plant.camera_rate=15",
    "plant.measurement_noise={position: 2, heading: 0.004}",
    "plant.disturbances=[{type: camera-latency, mean: 0.05, deviation: 0.02}]",
    "controller.period=0.1",
    "controller.signal_periods=2",
)
AT_5HZ = ("controller.period=0.2", "controller.signal_periods=1", "controller.time_limit=160")
LONG = ("controller.horizon_max=200", "controller.time_limit=160.05")


@dataclass(frozen=True)
class World:
    """Settings of a spec of experiments/, with further disturbances.

    `more` lists disturbances, each as name and size in KINDS. `layout` samples a part of each
    trial's spec. `plant` names another spec whose plant is used.
    """

    settings: tuple[str, ...] = HURT
    more: tuple[tuple[str, float], ...] = ()
    layout: Callable[[Random, Experiment, int], dict[str, Any]] | None = None
    base: str = OURS
    plant: str | None = None

    @property
    def body(self) -> float:
        """The radius of its robots [mm] or [um], even if the controller does not know it."""
        return experiment(self.plant or self.base).controller.body_radius

    def spec(
        self, seed: int, trial: int, settings: Sequence[str] = (), slow: bool = False
    ) -> Experiment:
        """Return the spec of a trial. If `slow`, it is controlled at 5 Hz."""
        rate = AT_5HZ if slow else ()
        spec = experiment(self.base, *rate, *self.settings, f"trials.seed={seed}", *settings)
        if self.layout:
            data = spec.model_dump(mode="json", exclude={"lab", "scale", "reference"})
            drawn = self.layout(np.random.default_rng([seed, trial]), spec, trial)
            spec = Experiment.model_validate(data | drawn)
        plant = experiment(self.plant).plant if self.plant else spec.plant
        sections = tuple(UnmodelledSection(type=kind, size=size) for kind, size in self.more)
        disturbances = (*plant.disturbances, *sections)
        return spec.model_copy(
            update={"plant": plant.model_copy(update={"disturbances": disturbances})}
        )


def _hurt(disturbance: str, *settings: str) -> World:
    """Create a world with one further shipped disturbance."""
    return World((*HURT, f"plant.disturbances=[{{{disturbance}}}]", *settings))


def _lacking(kind: str, size: float) -> World:
    """Create a world with one further effect that the model lacks."""
    return World(more=((kind, size),))


def _cells(disturbance: dict[str, Any], *settings: str) -> World:
    """Create a world of disturbed cells with one further shipped disturbance."""
    shipped = [
        disturbance.model_dump(mode="json") for disturbance in experiment(CELLS).plant.disturbances
    ]
    parts = json.dumps([*shipped, disturbance])
    return World((f"plant.disturbances={parts}", *settings), base=CELLS)


ANY_CELL = "plant.cells=null", "plant.a_error=0.5", "plant.disturbances.6.heading=3.1416"
BODY = {"type": "wobble", "radius": 8, "frequency": 1.5}  # um, Hz
WORLDS = {
    "base": World(),
    "bench": World((), base=BENCH),
    "paper-on-bench": World((), base=PAPER, plant=BENCH),
    "silent": _hurt("type: silent-radio, times: 3, duration: 1", "plant.lost_commands=0.02"),
    "sticking": _hurt("type: sticking, every: 5, duration: 0.5"),
    "stale": _hurt("type: stale-camera, times: 2, duration: 0.4, age: 0.2"),
    "repeating": _hurt("type: frozen-camera, times: 2, duration: 0.4"),
    "no-frames": _hurt("type: frozen-camera, repeats: false, times: 2, duration: 0.4"),
    "marker": _hurt("type: marker-off, heading: 0.1"),
    "battery": _hurt("type: battery, speed: 0.15, over: 20"),
    "wander": _hurt("type: wander, a: 0.1, speed: 0.1, time: 5"),
    # one thing each that the model lacks, or that few plans allow
    "sides": _lacking("sides", 0.2),
    "later": _lacking("later", 0.1),
    # at 20 Hz one direction of four gets out; 30 % of the commands lost, by each robot on its own
    "sparse-radio": _lacking("sparse-radio", 0.2),
    "lossy-radio": World((*HURT, "plant.lost_commands=0.3")),
    "slow-pictures": _lacking("slow-pictures", 0.06),
    "saturated-2": _lacking("saturated", 2.0),
    "saturated-4": _lacking("saturated", 4.0),
    "near-walls": World(layout=near_a_wall),
    "near-walls-bench": World((), layout=near_a_wall, base=BENCH),
    "dead": World((*HURT, "on_lost=drop"), (("dead", 8.0),)),
    "gap": World((*LONG, *HURT), layout=through_a_gap),
    "gap-bench": World(LONG, layout=through_a_gap, base=BENCH),
    "anywhere": World((*LONG, *HURT), layout=anywhere),
    "eight": World((*LONG, *HURT, "controller.accept_error=40"), layout=eight),
    # each robot late by its own, a floor that slopes, a strip of another floor, a lens
    "late": _hurt("type: radio, spread: 0.12"),
    "slide": _lacking("slide", 12.0),
    "strip": _lacking("strip", 300.0),
    "lens": _lacking("lens", 0.01),
    # models of a wrong shape: no value of any parameter explains how these robots move
    "slow-turning": _lacking("slow-turning", 0.25),
    "proportional": _lacking("proportional", 1.0),
    "rolling": _lacking("rolling", 0.2),
    "filling-buffer": _lacking("filling-buffer", 0.3),
    "pivot": _lacking("pivot", 20.0),
    "slow-stack": World(SLOW_STACK),
    "cells-askew": World((), (("askew", 0.35),), base=CELLS),
    # of experiments/benchmark
    **{name: World((), base=f"benchmark/{name}.yaml") for name in BENCHMARK},
    "cells": World((), base=CELLS),
    "cells-body": _cells(BODY, *ANY_CELL),
    "cells-pause": _cells({"type": "sticking", "every": 6, "duration": 1}),
    "cells-avoid": World((), (("avoid", 10.0),), base=CELLS),
}
"""Each world by its name."""
WRONG_SHAPES = (
    "slow-turning",
    "proportional",
    "rolling",
    "filling-buffer",
    "pivot",
    "slow-stack",
    "cells-askew",
)
"""The worlds in which the controller's model has a wrong shape."""
