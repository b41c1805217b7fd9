"""Tests of reading from a log whether its robots were real."""

import pytest
from testkit.batches import DISTURBED, experiment

from tetractl.core.trial import PlantInfo
from tetractl.log.read.trial_log import Origin

PLAIN = {"type": "sim", "camera_rate": 60}


@pytest.mark.parametrize(
    "disturbance",
    [
        {"measurement_noise": {"position": 1}},
        {"measurement_noise": {"heading": 0.01}},
        {"heading_noise": 0.1},
        {"dead_time": 0.1},
        {"lost_commands": 0.1},
        {"a_error": 0.1},
        {"speed_error": 0.1},
        {"disturbances": [{"type": "tracking-loss", "every": 3}]},
    ],
)
def test_any_disturbance_disturbs_a_simulation(disturbance):
    info = PlantInfo("sim", True, 60.0, {})
    assert Origin.from_spec(experiment(plant=PLAIN), info) is Origin.UNDISTURBED
    assert Origin.from_spec(experiment(plant=PLAIN | disturbance), info) is Origin.DISTURBED


@pytest.mark.parametrize(
    ("facts", "origin"),
    [
        ({}, Origin.LAB),
        ({"server": "Motive"}, Origin.LAB),
        ({"server": "Motive", "emulated": "camera"}, Origin.EMULATED),
    ],
)
def test_an_emulated_device_makes_an_emulated_lab(facts, origin):
    info = PlantInfo("lab", False, 120.0, facts)
    assert Origin.from_spec(experiment(plant=DISTURBED), info) is origin
    assert not origin.simulated
