"""Trials side by side against the same trials one by one."""

import math

import numpy as np
import pytest
from support.paths import ROOT
from support.trials import experiment

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.errors import UsageError
from tetractl.experiment.load import load_spec
from tetractl.plant.sim_plants import SimPlants
from tetractl.plant.simulation import SimPlant

pytestmark = pytest.mark.slow

TRIALS, STEPS = 5, 60
RADIO = {"type": "radio", "delay": 0.01, "jitter": 0.02, "spread": 0.03, "loss": 0.1}
WHEELS = {"radius": 40, "watchdog": 0.25, "lag": 0.03}
NOISE = {"position": 0.2, "heading": 0.003}
PLANTS = {
    "ideal wheels, sent once a period": ({"wheels": {"radius": 40}}, {"drive": {}}),
    "frames and samples rarer than commands": (
        {"wheels": WHEELS},
        {"drive": {"rate": 20}, "camera_rate": 4, "truth_rate": 7, "measurement_noise": NOISE},
    ),
    "speeds repeated, commands lost": (
        {"wheels": WHEELS},
        {"drive": {"rate": 40, "recompute": False, "lag": 0.04}, "lost_commands": 0.3},
    ),
    "late commands, that robots get at different times": (
        {"wheels": WHEELS},
        {"drive": {"rate": 30, "lead": 0.02}, "dead_time": 0.03, "disturbances": [RADIO]},
    ),
    "radio silent for longer than the watchdog, uneven rates": (
        {"wheels": WHEELS},
        {
            "drive": {"rate": 40, "count": 7.9, "dead_zone": 4, "dead_zone_error": 2, "lag": 0.04},
            "camera_rate": 70,
            "truth_rate": 300,
            "heading_noise": 0.1,
            "a_error": 0.1,
            "speed_error": 0.1,
            "measurement_noise": NOISE,
            "disturbances": [
                {"type": "silent-radio", "duration": 0.6, "between": [0.5, 2.0]},
                {"type": "frame-loss", "share": 0.3, "burst": 20},
                {"type": "camera-latency", "mean": 0.05, "deviation": 0.02},
            ],
        },
    ),
}


def spec_of(name):
    if name == "bench":
        return load_spec(ROOT / "experiments" / "three_m3pi_bench.yaml").experiment
    fields, plant = PLANTS[name]
    return experiment(plant=plant, controller={"type": "mpc", "period": 0.1}, **fields)


@pytest.mark.parametrize("name", ["bench", *PLANTS])
def test_a_trial_side_by_side_has_the_bits_of_the_trial_alone(name):
    spec = spec_of(name)
    seeds = [np.random.SeedSequence(7, spawn_key=(trial,)) for trial in range(TRIALS)]
    plants = SimPlants(spec.plant, spec.setup, seeds)
    directions = np.random.default_rng(3).uniform(-math.pi, math.pi, (STEPS, TRIALS))
    directions[1:] = np.where(np.arange(1, STEPS)[:, None] % 7 > 0, directions[:-1], directions[1:])
    shown = [plants.step(each) for each in directions]
    touched = np.any([each.touched for each in shown], axis=0)
    for trial in range(TRIALS):
        seed = np.random.SeedSequence(7, spawn_key=(trial,))
        plant = SimPlant(spec.plant, spec.setup, VirtualClock(), seed)
        plant.open()
        for k, each in enumerate(shown):
            plant.send(Steer(float(directions[k, trial])))
            plant.clock.sleep_until(round((k + 1) * spec.setup.period_s * SECOND))
            seen = plant.observe()
            assert seen.sampled_ns == each.sampled_ns[trial]
            assert seen.poses.array().T.tolist() == each.poses[trial].tolist()
            assert plant.poses.array().T.tolist() == each.truth[trial].tolist()
        plant.motion.check()
        check = plant.motion.path_check
        assert touched[trial] == (check.entered.any() or check.edge.min() < 0)


@pytest.mark.parametrize(
    ("plant", "why"),
    [
        ({}, "only robots on wheels"),
        (
            {"drive": {}, "disturbances": [{"type": "sticking", "every": 1}]},
            "disturbances of poses",
        ),
        (
            {"drive": {}, "disturbances": [{"type": "planning-time", "least": 2}]},
            "less than a period",
        ),
    ],
)
def test_what_does_not_run_side_by_side_is_refused(plant, why):
    spec = experiment(plant=plant, wheels=WHEELS | {"watchdog": 5})
    with pytest.raises(UsageError, match=why):
        SimPlants(spec.plant, spec.setup, [np.random.SeedSequence(1)])
