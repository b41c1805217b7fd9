"""Tests of Feedback Ensemble Control: two alternating modes, and distances that fall without a
field.
"""

import numpy as np
import pytest
from testkit.paths import ROOT
from testkit.plants import sim
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import FieldOff
from tetractl.core.errors import SpecError
from tetractl.core.plan import Outcome
from tetractl.run.checked_controller import build_controller
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

FIELDS = {"type": "ensemble", "time_limit": 200.2, "period": 0.2}


def drive(fields, **changes):
    """Run to the end; the sum of distances at each step, whether the field was off, the outcome."""
    spec = experiment(controller=FIELDS | fields, obstacles=[], **changes)
    plant = sim(spec)
    controller = build_controller(spec, 1)
    plant.open()
    sums = []
    off = []
    plans = []
    for k in range(1002):
        observation = plant.observe()
        sums.append(observation.poses.distances(spec.setup.targets).sum())
        decision = controller.plan(observation)
        if isinstance(decision, Outcome):
            return np.array(sums), np.array(off), plans, decision
        off.append(decision.instead == FieldOff())
        plans.append(decision)
        plant.send(decision.action)
        plant.clock.sleep_until((k + 1) * SECOND // 5)
    raise AssertionError


def test_the_sum_of_distances_falls_while_the_field_is_off():
    sums, off, _, outcome = drive({})
    assert outcome is Outcome.NO_BETTER_PLAN
    assert off.any()
    assert not off.all()
    assert (np.diff(sums)[off] < 0).all()
    assert sums[-1] < 0.5 * sums[0]


def test_one_robot_comes_near_its_target():
    robots = [{"name": "r", "start": [900, 800], "target": [1700, 500], "a": 6, "speed": 180}]
    sums, *_ = drive({"rate": 0.7}, robots=robots)
    assert sums[-1] < 2 * 180 / (0.7 * 6)  # the width of its circle under the rotating field


@pytest.mark.parametrize("dead_time", [0.0, 0.1, 0.4])
def test_a_dead_time_that_is_told_is_predicted_over(dead_time):
    """Without noise, where a decision acts is where the robots then are."""
    plant = {"type": "sim", "dead_time": dead_time}
    spec = experiment(controller=FIELDS | {"dead_time": dead_time}, obstacles=[], plant=plant)
    world = sim(spec)
    controller = build_controller(spec, 1)
    world.open()
    starts = []
    due = []
    for k in range(30):
        now = world.observe()
        while due and due[0][0] <= world.clock.now():
            when, promised = due.pop(0)
            starts.append((when, promised))
        plan = controller.plan(now)
        world.send(plan.action)
        acts = now.sampled_ns + round(dead_time * SECOND)
        due.append((acts, plan.path[0]))
        world.clock.sleep_until((k + 1) * SECOND // 5)
    true_poses = {s.observation.sampled_ns: s.truth.array() for s in world.samples()}
    checked = [(true_poses[t], p) for t, p in starts if t in true_poses]
    assert checked
    for truth, promised in checked:
        assert promised == pytest.approx(truth, abs=1e-6)


def test_a_lab_cannot_switch_its_field_off():
    sets = ["controller={type: ensemble}"]
    spec = load_spec(ROOT / "experiments/three_m3pi_lab.yaml", sets)  # as a simulation
    with pytest.raises(
        SpecError, match="cannot switch off the field, but the controller ensemble does so"
    ):
        select_plant(spec, "lab")
