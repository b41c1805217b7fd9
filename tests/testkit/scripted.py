"""An optimiser with scripted answers, and the observations of a controller under test."""

from dataclasses import replace

import numpy as np

from tetractl.core.plan import Search, StopReason
from tetractl.core.poses import Observation, Poses
from tetractl.spec.controller import Host

STARTS = np.array([[900.0, 800, 0], [900, 1200, 0], [900, 1600, 0]])
TARGETS = np.array([[1700.0, 500, 0], [1700, 1500, 0], [1700, 2000, 0]])


def observation_of(poses=STARTS, now_ns=0):
    """An observation of robots at poses (N, 3), all tracked, by default at the start."""
    all_valid = np.ones(len(poses), np.bool_)
    return Observation(0, now_ns, now_ns, Poses.from_array(np.array(poses)), all_valid)


def still():
    """A timer that stands still: a slow computer must not end a search."""
    return 0


def mpc(experiment, key, optimizer=None, timer=still, **setup_changes):
    """The experiment's controller; `optimizer` is None for its own."""
    host = Host(timer=timer) if optimizer is None else Host(lambda _: optimizer, timer)
    setup = replace(experiment.setup, **setup_changes)
    return experiment.controller.build(setup, key, host)


class Scripted:
    """An optimiser that writes down what it was asked and answers with costs by length."""

    def __init__(self, costs=None):
        self.costs = costs or {}
        self.asked = []

    def search(self, problem, length, warm, key, limits):
        start = None if warm is None else warm.tolist()
        self.asked.append((length, start, key, limits.evaluations))
        cost = self.costs.get(length, 100.0 + length)
        signals = np.arange(1, length + 1) / 10 + len(self.asked) / 1000
        return Search(length, signals, cost, np.array([cost]), 10, StopReason.ITERATIONS)

    def forget(self):
        searches = self.asked
        self.asked = []
        return searches
