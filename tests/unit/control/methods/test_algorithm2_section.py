"""Tests of the fields of Algorithm 2: limits that are shown, sizes, and the problem."""

import numpy as np
import pytest
from testkit.trials import THREE_M3PI, experiment

from tetractl.control.methods.algorithm2_section import PsoMpc
from tetractl.core.poses import Poses


def section(**fields):
    return PsoMpc.model_validate({"type": "pso-mpc"} | fields)


def test_a_trial_may_last_as_long_as_its_steps_which_count_from_0():
    fitted = section(steps_max=9, period=0.2).fitted(False, 200.0)
    assert fitted.time_limit == pytest.approx(10 * 0.2)
    stated = section(steps_max=9, time_limit=5.0).fitted(False, 200.0)
    assert stated.time_limit == 5


def test_the_limits_are_shown():
    bounds = section(steps_max=9, horizon_max=7).bounds()
    assert bounds["control steps of a trial"] == "at most 10"
    assert bounds["horizons at step 0"] == "1 ... 7 signals"
    optimizer = section().optimizer
    shown = bounds["cost evaluations of a horizon"]
    assert shown == f"at most {optimizer.evaluations_max}"
    multistart = section(optimizer={"type": "multistart"})
    has_limit = bool(multistart.optimizer.evaluations_max)
    assert ("cost evaluations of a horizon" in multistart.bounds()) == has_limit
    assert multistart.iterations_max == multistart.optimizer.iterations_max


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_numbers_held_are_those_of_the_swarm_and_of_the_jacobian(robots):
    """Positions, velocities, bests and poses of particles; a row for each residual."""
    length = 11
    fields = section(horizon_max=length)
    setup = experiment(robots=THREE_M3PI["robots"][:robots]).setup
    assert len(setup.obstacles) == 1
    particles = fields.optimizer.evaluations_min
    rows = 2 * robots + robots * (robots // 2) + robots
    expected = 4 * particles * (length + robots) + rows * length
    assert fields.numbers_held(setup) == expected


def test_the_problem_begins_at_the_starts_or_at_given_poses():
    fields = section(motion="exact", obstacle_weight=77)
    setup = experiment().setup
    problem = fields.problem(setup)
    assert problem.poses.array().tolist() == setup.starts.array().tolist()
    assert (problem.motion, problem.obstacle_weight, problem.swept) == ("exact", 77, False)
    moved = Poses.from_array(np.ones((3, 3)))
    assert fields.problem(setup, moved).poses is moved
