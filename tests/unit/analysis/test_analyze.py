"""The analysis of an experiment: gaps, maps and advice."""

import numpy as np
import pytest
from support.trials import THREE_M3PI, experiment

from tetractl.analysis.analysis_text import advice, as_json, tables
from tetractl.analysis.analyze import Change, analyze, best_change, most_alike, respaced
from tetractl.analysis.steering import planner, plans
from tetractl.control.mpc_section import RecommendedMpc
from tetractl.control.optimizers.multistart import Multistart
from tetractl.experiment.controller import ALONE
from tetractl.tools.table.table_files import json_text

pytestmark = pytest.mark.slow

A_RAD_S = (6, 4, 3)  # of green, blue and red
SETUP = experiment().setup
CONTROLLER = {
    "type": "mpc",
    "period": 0.2,
    "horizon_max": 60,
    "estimate": False,
    "collision": {"walls": False, "adaptive": False, "stop_before_collision": False},
}
NOISE = {"type": "sim", "a_error": 0.05, "heading_noise": 0.05}


def analysis_of(a=A_RAD_S, **changes):
    """The analysis, by two plans, of the first robots of the paper with these rates [rad/s]."""
    robots = [robot | {"a": rate} for robot, rate in zip(THREE_M3PI["robots"], a, strict=False)]
    fields = {"robots": robots, "controller": CONTROLLER, "plant": NOISE} | changes
    return analyze(experiment(**fields), plans=2)


@pytest.fixture(scope="module")
def analysis_of_three():
    return analysis_of()


@pytest.fixture(scope="module")
def analysis_without_plan():
    """The horizon is too short to reach the targets."""
    return analysis_of(controller=CONTROLLER | {"horizon_max": 12})


def test_the_smallest_gap_is_of_the_two_robots_that_are_most_alike():
    slower, faster = most_alike(SETUP)
    assert SETUP.a[faster] / SETUP.a[slower] == pytest.approx(4 / 3)
    assert SETUP.names[slower] == "red"
    assert SETUP.names[faster] == "blue"


def test_robots_spaced_anew_keep_their_order_and_their_mean():
    before = np.log(SETUP.a)
    after = np.log(respaced(SETUP, 0.1).a)
    assert np.array_equal(np.argsort(after), np.argsort(before))
    gaps = np.diff(np.sort(after))
    assert gaps == pytest.approx(np.log(1.1))
    assert after.mean() == pytest.approx(before.mean())


def change_to(a, error):
    """A change of the a of one robot from 4 [rad/s] that leaves this error [mm]."""
    return Change(robot="r", a=4, a_advised=a, mean_total_error=error)


SMALL_CHANGE = change_to(4.6, error=10.5)
CHANGES = [SMALL_CHANGE, change_to(6, error=10), change_to(4.2, error=19)]


def test_no_change_is_advised_where_none_makes_much_better():
    assert best_change(CHANGES, 12.0) is None
    assert best_change([], 12.0) is None


@pytest.mark.long
def test_alike_robots_are_found_and_a_better_a_is_advised():
    analysis = analysis_of(a=(6, 3.1, 3))
    assert analysis.looked
    assert analysis.alike == ("red", "blue")
    change = analysis.change
    assert change.robot in analysis.alike
    assert change.mean_total_error < 0.8 * analysis.steering.error
    assert f"change a of {change.robot} from {change.a:g} to {change.a_advised:g}" in advice(
        analysis
    )


def test_robots_that_differ_are_advised_no_change(analysis_of_three):
    assert not analysis_of_three.looked
    assert analysis_of_three.change is None


def test_robots_more_apart_are_easier(analysis_of_three):
    error_by_gap = dict(analysis_of_three.by_gap)
    assert np.isfinite(error_by_gap[0.5])
    # hardly a plan for robots as alike as 2 %, or none: NaN
    assert not error_by_gap[0.02] < 5 * error_by_gap[0.5]


def test_the_steering_says_how_well_the_robots_can_be_corrected(analysis_of_three):
    steering = analysis_of_three.steering
    assert (np.diff(steering.singular) <= 0).all()
    assert steering.weakest.sum() == pytest.approx(1)
    assert 0 < steering.shortest <= CONTROLLER["horizon_max"]
    assert (steering.open_loop > steering.errors).all()


def test_where_no_plan_reaches_json_has_no_number(analysis_without_plan):
    items = as_json(analysis_without_plan)
    assert items["mean_total_error"] is None
    assert items["plans_that_reach"] == 0
    assert "NaN" not in json_text(items)


def test_more_noise_is_more_error():
    quiet = analysis_of(a=(6,), plant={"type": "sim", "heading_noise": 0.01})
    loud = analysis_of(a=(6,), plant={"type": "sim", "heading_noise": 0.2})
    assert loud.steering.error > 5 * quiet.steering.error


def test_what_the_plant_has_besides_the_noise_is_said():
    analysis = analysis_of(a=(6,), plant=NOISE | {"dead_time": 0.1, "lost_commands": 0.1})
    assert analysis.left_out == ("dead_time", "lost_commands")
    rows = dict(tables(analysis)[0].rows)
    assert "without dead_time, lost_commands" in rows["noise assumed"]


def test_any_controller_is_analysed_by_multistart():
    section = planner(experiment(controller={"type": "ensemble", "period": 0.25}))
    assert isinstance(section.optimizer, Multistart)
    assert section.period == 0.25
    of_swarm = planner(experiment())
    assert isinstance(of_swarm.optimizer, Multistart)
    assert of_swarm.motion == experiment().controller.motion


def test_no_deadline_ends_a_search_however_busy_the_machine_is(monkeypatch):
    build = RecommendedMpc.build
    hosts = []

    def watched_build(section, setup, key, host=ALONE):
        hosts.append(host)
        return build(section, setup, key, host)

    monkeypatch.setattr(RecommendedMpc, "build", watched_build)
    spec = experiment(controller=CONTROLLER)
    two_plans = list(plans(planner(spec), spec.setup, seed=0, count=2))
    assert len(two_plans) == 2
    before_ns = [host.timer() for host in hosts]
    after_ns = [host.timer() for host in hosts]
    assert len(hosts) == 2
    assert before_ns == after_ns  # deadlines are read on this clock, which stands
