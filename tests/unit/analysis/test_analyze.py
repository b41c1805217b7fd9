"""The analysis of an experiment: gaps, maps and advice."""

import numpy as np
import pytest
from support.trials import THREE_M3PI, experiment

from tetractl.analysis.analysis_text import NO_PLAN, advice, as_json, tables
from tetractl.analysis.analyze import Change, analyze, best_change, most_alike, respaced
from tetractl.analysis.steering import planner, plans
from tetractl.control.mpc_section import RecommendedMpc
from tetractl.control.optimizers.multistart import Multistart
from tetractl.core.errors import UsageError
from tetractl.core.table.table_files import json_text
from tetractl.experiment.controller import ALONE
from tetractl.view.figures.analysis import analysis_figure

pytestmark = pytest.mark.slow

SETUP = experiment().setup
CONTROLLER = {
    "type": "mpc",
    "period": 0.2,
    "horizon_max": 60,
    "estimate": False,
    "collision": {"walls": False, "adaptive": False, "stop_before_collision": False},
}
NOISE = {"type": "sim", "a_error": 0.05, "heading_noise": 0.05}


def of(a=(6, 4, 3), **changes):
    robots = [robot | {"a": value} for robot, value in zip(THREE_M3PI["robots"], a, strict=False)]
    given = {"robots": robots, "controller": CONTROLLER, "plant": NOISE} | changes
    return analyze(experiment(**given), plans=2)


def test_the_smallest_gap_and_robots_spaced_anew():
    alike = most_alike(SETUP)
    assert alike.gap == pytest.approx(1 / 3)
    assert (SETUP.names[alike.low], SETUP.names[alike.high]) == ("red", "blue")
    spaced = respaced(SETUP, 0.1)
    assert np.argsort(spaced.a).tolist() == np.argsort(SETUP.a).tolist()
    assert np.diff(np.sort(np.log(spaced.a))) == pytest.approx(np.log(1.1))
    assert np.log(spaced.a).mean() == pytest.approx(np.log(SETUP.a).mean())


def test_of_changes_about_as_good_the_smallest_is_advised():
    changes = [Change("r", 4, 4.6, 10.5), Change("r", 4, 6, 10), Change("r", 4, 4.2, 19)]
    assert best_change(changes, 20.0) is changes[0]
    assert best_change(changes, 12.0) is None
    assert best_change([], 12.0) is None
    impossible = Change("r", 4, 4.1, np.nan)
    assert best_change([impossible, *changes], np.nan) is changes[0]
    assert best_change([impossible], np.nan) is None


def test_alike_robots_are_found_and_a_better_a_is_advised():
    found = of(a=(6, 3.1, 3))
    assert found.looked
    assert found.alike == ("red", "blue")
    change = found.change
    assert change is not None
    assert change.robot in found.alike
    assert change.error < 0.8 * found.steering.error
    assert f"change a of {change.robot} from {change.old:g} to {change.new:g}" in advice(found)


def test_robots_more_apart_and_fewer_are_easier():
    found = of()
    assert not found.looked
    assert found.change is None
    by_gap, by_count = dict(found.by_gap), dict(found.by_count)
    assert np.isfinite(by_gap[0.5])
    assert not by_gap[0.02] < 5 * by_gap[0.5]  # hardly a plan for robots as alike as that, or none
    assert by_count[1] < by_count[3] == found.steering.error
    here = found.steering
    assert (np.diff(here.singular) <= 0).all()
    assert here.weakest.sum() == pytest.approx(1)
    assert here.shortest is not None
    assert (here.open_loop > here.errors).all()


def test_where_no_plan_reaches_there_are_no_millimetres():
    found = of(controller=CONTROLLER | {"horizon_max": 12})
    assert found.steering is None
    shown = [list(table.rows) for table in tables(found)]
    assert ("plans that reach", "0 of 2, to 48 mm") in shown[0]
    assert ("fewest signals that reach", NO_PLAN) in shown[0]
    assert [row[1] for row in shown[-1]] == [NO_PLAN] * 3
    assert advice(found).startswith(f"advice: {NO_PLAN}")
    items = as_json(found)
    assert (items["mean_total_error"], items["plans_that_reach"]) == (None, 0)
    assert "NaN" not in json_text(items)
    with pytest.raises(UsageError, match=NO_PLAN):
        analysis_figure(found)


def test_one_robot_has_no_map():
    found = of(a=(6,))
    assert (found.alike, found.by_gap, found.looked) == (None, (), False)
    assert len(as_json(found)["robots"]) == 1
    assert advice(found).startswith("advice: none is needed")
    assert len(tables(found)) == 3


def test_more_noise_is_more_error():
    quiet, loud = (of(a=(6,), plant={"type": "sim", "heading_noise": walk}) for walk in (0.01, 0.2))
    assert loud.steering.error > 5 * quiet.steering.error


def test_what_the_plant_has_beside_the_noise_is_said():
    found = of(a=(6,), plant=NOISE | {"dead_time": 0.1, "lost_commands": 0.1})
    assert found.left_out == ("dead_time", "lost_commands")
    assert "without dead_time, lost_commands" in dict(tables(found)[0].rows)["noise assumed"]


def test_any_controller_is_analysed_by_multistart():
    section = planner(experiment(controller={"type": "ensemble", "period": 0.25}))
    assert isinstance(section.optimizer, Multistart)
    assert section.period == 0.25
    own = planner(experiment())  # of the particle swarm
    assert isinstance(own.optimizer, Multistart)
    assert own.motion == experiment().controller.motion


def test_no_deadline_ends_a_search_however_busy_the_machine_is(monkeypatch):
    build = RecommendedMpc.build
    hosts = []

    def watched_build(section, setup, key, host=ALONE):
        hosts.append(host)
        return build(section, setup, key, host)

    monkeypatch.setattr(RecommendedMpc, "build", watched_build)
    spec = experiment(controller=CONTROLLER)
    assert len(list(plans(planner(spec), spec.setup, seed=0, count=2))) == 2
    before_ns = [host.timer() for host in hosts]
    after_ns = [host.timer() for host in hosts]
    assert len(hosts) == 2
    assert before_ns == after_ns  # deadlines are read on this clock, which stands


@pytest.mark.parametrize("adaptive", [True, False])
def test_robots_that_start_within_a_margin_are_steered_out_of_it(adaptive):
    """As the controller does: 4 mm from the edge, with a margin of 50."""
    robot = THREE_M3PI["robots"][1] | {"start": [604, 1200]}
    collision = {"margin": 50, "adaptive": adaptive}
    found = of(a=(6,), robots=[robot], controller=CONTROLLER | {"collision": collision})
    assert found.steering is not None
