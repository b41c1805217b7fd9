"""Belief about lost commands: which of the last two arrived at each robot."""

import numpy as np
import pytest
from support.paths import ROOT

from tetractl.control.knowledge import Knowledge
from tetractl.core.clock import SECOND, VirtualClock
from tetractl.experiment.load import load_spec
from tetractl.plant.simulation import SimPlant

EXPERIMENT = ROOT / "experiments" / "three_m3pi.yaml"


def drive(losses, dead_time=0.05, steps=200):
    """Drive robots that lose a fifth of their commands; return what arrived, and was believed to,
    and the errors of the predicted positions, (steps, N) each."""
    settings = [f"plant.dead_time={dead_time}", "plant.lost_commands=0.2"]
    experiment = load_spec(EXPERIMENT, settings).experiment
    clock = VirtualClock()
    plant = SimPlant(experiment.plant, experiment.setup, clock, np.random.SeedSequence(3))
    plant.open()
    problem = experiment.controller.problem(experiment.setup)
    knowledge = Knowledge(problem, 0.2, dead_time, None, losses)
    arrived, believed, missed = [], [], []
    for k, u in enumerate(np.random.default_rng(1).uniform(-2, 2, steps)):
        clock.sleep_until(k * SECOND // 5)
        ahead = knowledge.seen(plant.observe()).poses
        if k > 2:
            believed.append(knowledge.predictor.recent[-2].arrived.copy())
        command = plant.steer(float(u))
        knowledge.sent(command.sent_ns, float(u))
        arrived.append(command.delivered)
        clock.sleep_until(clock.now() + round(dead_time * SECOND) - 1)
        plant.observe()
        missed.append(np.hypot(*(plant.poses.xy - ahead.xy).T))
    return np.array(arrived[1:-2]), np.array(believed), np.array(missed)


def test_it_is_seen_which_commands_arrived():
    arrived, believed, _ = drive(losses=True)
    assert (~arrived).mean() == pytest.approx(0.2, abs=0.05)
    assert (arrived == believed).mean() > 0.95


def test_the_prediction_is_better_for_it():
    ignorant, knowing = drive(False)[2], drive(True)[2]
    assert knowing.mean() < 0.35 * ignorant.mean()


def test_without_losses_all_arrived():
    _, believed, _ = drive(losses=False)
    assert believed.all()
