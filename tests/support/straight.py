"""A controller that is no MPC: every robot receives the bearing of the targets until it arrives.

It stands for what another package may bring: the contract suite runs against it, and so do the
trial loop, the log and `verify`, none of which knows it.
"""

from typing import Literal

import numpy as np

from tetractl.control.cost import costs_along, predict
from tetractl.control.curves import bearing
from tetractl.control.rng import mix
from tetractl.core.plan import Outcome, Plan, Problem, Search, StopReason
from tetractl.core.registries import CONTROLLERS
from tetractl.experiment.controller import ALONE, ControllerSection
from tetractl.model.obstacles import Obstacles


class Straight(ControllerSection):
    """Steer by the bearing of the targets."""

    type: Literal["straight"]
    signals: int = 20
    """Signals predicted ahead."""

    def build(self, setup, key, host=ALONE):
        return _Straight(self, setup, key)


class _Straight:
    def __init__(self, section, setup, key):
        self.section, self.setup, self.key, self.k = section, setup, key, 0

    def plan(self, observation, last_command=None, earlier=()):
        setup, period = self.setup, self.section.period
        gaps = observation.poses.distances(setup.targets)
        if (gaps <= self.section.arrival_tolerance).all():
            return Outcome.ARRIVED
        if self.k > self.section.steps_max:
            return Outcome.STEPS_MAX
        robots = (observation.poses, setup.targets, setup.a, setup.speed)
        region = Obstacles.of(setup.obstacles)
        problem = Problem(*robots, "exact", period, period, region, 0.0, False)
        signals = np.full(self.section.signals, bearing(problem))
        path = predict(problem, signals)
        costs = costs_along(problem, path[:, None])
        cost, hits = float(costs.total[0]), float(costs.obstacle[0])
        found = Search(len(signals), signals, cost, np.array([cost]), 1, StopReason.ITERATIONS)
        self.k += 1
        return Plan(signals, path, cost, cost, hits, (found,), 0, mix(self.key, self.k - 1))


def install(monkeypatch):
    """Make `type: straight` known, as another package's entry point would."""
    here = {**CONTROLLERS.builtin, "straight": "support.straight:Straight"}
    monkeypatch.setattr(CONTROLLERS, "builtin", here)
