"""Robots that a disturbance holds: what `moving` is for it, and what the log says."""

from typing import Literal

import numpy as np
import pytest
from support.plants import sim
from support.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection

PLANTS = {
    "direct": {},
    "wheels": {"drive": {"rate": 40}},
    "cells": {"cells": {"walls": False}},
}


class HoldsSection(DisturbanceSection):
    """Holds the first robot from 1 s on, for `time`, counted by its time of moving."""

    type: Literal["holds"] = "holds"
    time: float

    def build(self, setup, rng):
        return Holds(self.time, len(setup.names))


class Holds(Disturbance):
    def __init__(self, time, count):
        self.time, self.driven = time, np.zeros(count)

    def moved(self, poses, moving, seconds, time_s):
        self.driven = self.driven + moving * seconds
        return poses

    def varied(self, a, speed, time_s):
        held = (self.driven >= 1) & (self.driven < 1 + self.time)
        held[1:] = False
        return np.where(held, 0.0, a), np.where(held, 0.0, speed)


def drive(plant, seconds, more=()):
    held = [HoldsSection(time=seconds), *more]
    spec = experiment(wheels={"radius": 40}, obstacles=[], plant=plant)
    section = spec.plant.model_copy(update={"disturbances": held})
    simulated = sim(spec.model_copy(update={"plant": section}))
    simulated.open()
    said, gone = [], []
    for k in range(40):
        if k < 35:
            simulated.send(Steer(0.5 * (k % 3)))
        elif k == 35:
            simulated.stop()
        simulated.clock.sleep_until((k + 1) * SECOND // 5)
        gone += [sample.truth.x[0] for sample in simulated.samples()]
        said += [(note.t_ns / SECOND, note.text) for note in simulated.news()
                 if not hasattr(note, "direction")]  # fmt: skip
    return simulated, said, np.array(gone)


@pytest.mark.parametrize("plant", PLANTS.values(), ids=list(PLANTS))
def test_a_robot_that_is_held_for_a_time_of_driving_goes_on(plant):
    """It was given moving = 0 for that robot, so that the time of driving stood still too."""
    _, said, x = drive(plant, 2.0)
    still = np.abs(np.diff(x)) < (1e-9 if not plant.get("cells") else 0.5)
    assert still[150:350].all()
    assert not still[370:].all()
    assert said == []


@pytest.mark.parametrize("plant", PLANTS.values(), ids=list(PLANTS))
def test_a_robot_that_never_moves_is_reported_once(plant):
    simulated, said, _ = drive(plant, 1000.0)
    ((when, text),) = said
    assert text == "green does not move though commanded to"
    assert when == pytest.approx(4.2, abs=0.3)
    assert simulated.settle().stood.startswith("green stood for 6 s though commanded")
