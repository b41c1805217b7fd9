"""Tests of the plans along which choices of cells are compared."""

import pytest
from testkit.trials import experiment
from tetractl_microscope.choice.first_plans import search_first_plans, select_planner

from tetractl.control.methods.mpc_section import RecommendedMpc
from tetractl.control.search.optimizers.multistart import Multistart
from tetractl.spec.controller import ALONE

pytestmark = pytest.mark.slow

CONTROLLER = {
    "type": "mpc",
    "period": 0.2,
    "horizon_max": 60,
    "estimate": False,
    "collision": {"walls": False, "adaptive": False, "stop_before_collision": False},
}


def test_any_controller_is_replaced_by_multistart():
    section = select_planner(experiment(controller={"type": "ensemble", "period": 0.25}))
    assert isinstance(section.optimizer, Multistart)
    assert section.period == 0.25
    of_swarm = select_planner(experiment())
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
    two_plans = list(search_first_plans(select_planner(spec), spec.setup, seed=0, count=2))
    assert len(two_plans) == 2
    before_ns = [host.timer() for host in hosts]
    after_ns = [host.timer() for host in hosts]
    assert len(hosts) == 2
    assert before_ns == after_ns  # deadlines are read on this clock, which stands
