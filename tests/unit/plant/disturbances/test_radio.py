"""Tests of the disturbances of commands: each changes what it says, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.plant.disturbances.radio import (
    PlanningTimeSection,
    RadioSection,
    SilentRadioSection,
)
from tetractl.spec.disturbance import DelayedCommand

SETUP = experiment().setup
ROBOTS = len(SETUP.names)
SENT_NS = 2 * SECOND
DUE_NS = SENT_NS + 1_000_000
COMMAND = DelayedCommand(SENT_NS, DUE_NS, Steer(0.5), np.ones(ROBOTS, dtype=bool))


def radio(seed=1, **fields):
    section = RadioSection.model_validate({"type": "radio"} | fields)
    return section.build(SETUP, np.random.default_rng(seed))


def test_a_radio_without_settings_changes_nothing():
    sent = radio().sent(COMMAND)
    assert sent.reached.all()
    assert replace(sent, reached=COMMAND.reached) == COMMAND


def test_a_delay_is_added_to_the_time_at_which_the_command_would_act():
    sent = radio(delay=0.25).sent(COMMAND)
    assert sent.due_ns == DUE_NS + SECOND // 4
    assert (sent.sent_ns, sent.action, sent.late_ns) == (SENT_NS, Steer(0.5), None)


def test_jitter_is_uniform_on_top_of_the_delay_and_the_same_for_all_robots():
    disturbance = radio(delay=0.1, jitter=0.2)
    delays_s = np.array([(disturbance.sent(COMMAND).due_ns - DUE_NS) / SECOND for _ in range(400)])
    assert delays_s.min() == pytest.approx(0.1, abs=0.005)
    assert delays_s.max() == pytest.approx(0.3, abs=0.005)
    assert delays_s.mean() == pytest.approx(0.2, abs=0.01)
    assert disturbance.sent(COMMAND).late_ns is None


def test_the_spread_is_each_robots_own_constant_delay_and_adds_to_an_earlier_one():
    disturbance = radio(spread=0.1)
    late_ns = disturbance.sent(COMMAND).late_ns
    assert (late_ns >= 0).all() and (late_ns <= 0.1 * SECOND).all()
    assert np.unique(late_ns).size == ROBOTS
    assert late_ns.tolist() == disturbance.sent(COMMAND).late_ns.tolist(), "for the whole trial"
    later = disturbance.sent(replace(COMMAND, late_ns=np.arange(ROBOTS)))
    assert later.late_ns.tolist() == (late_ns + np.arange(ROBOTS)).tolist()
    kept = radio(delay=0.1).sent(replace(COMMAND, late_ns=np.arange(ROBOTS)))
    assert kept.late_ns.tolist() == list(range(ROBOTS)), "a radio without spread keeps the delays"
    drawn_ns = [radio(seed, spread=0.1).sent(COMMAND).late_ns for seed in range(300)]
    assert np.mean(drawn_ns) / SECOND == pytest.approx(0.05, abs=0.005)


@pytest.mark.parametrize(("loss", "share"), [(0.0, 0.0), (0.25, 0.25), (0.9, 0.9)])
def test_a_transmission_is_lost_as_often_as_the_spec_says_for_each_robot(loss, share):
    disturbance = radio(loss=loss)
    reached = np.array([disturbance.sent(COMMAND).reached for _ in range(2000)])
    assert 1 - reached.mean(axis=0) == pytest.approx([share] * ROBOTS, abs=0.04)


def test_a_robot_that_an_earlier_disturbance_excluded_stays_excluded():
    nobody = replace(COMMAND, reached=np.zeros(ROBOTS, dtype=bool))
    assert not radio(loss=0.5).sent(nobody).reached.any()


def test_the_same_seed_gives_the_same_radio():
    fields = {"jitter": 0.2, "spread": 0.1, "loss": 0.4}
    one, other = radio(7, **fields).sent(COMMAND), radio(7, **fields).sent(COMMAND)
    assert one.due_ns == other.due_ns
    assert one.reached.tolist() == other.reached.tolist()


def test_a_silent_radio_loses_what_is_sent_in_the_interval_whenever_it_would_act():
    section = {"type": "silent-radio", "between": [2.0, 2.0], "duration": 0.5}
    silent = SilentRadioSection.model_validate(section).build(SETUP, np.random.default_rng(1))
    at_s = {1.99: True, 2.0: False, 2.4: False, 2.5: True}
    for sent_s, received in at_s.items():
        command = replace(COMMAND, sent_ns=round(sent_s * SECOND), due_ns=round(2.45 * SECOND))
        sent = silent.sent(command)
        assert sent.reached.tolist() == [received] * ROBOTS
        assert (sent.due_ns, sent.action) == (command.due_ns, command.action)


def test_planning_takes_between_its_shortest_and_longest_time():
    section = PlanningTimeSection.model_validate(
        {"type": "planning-time", "least": 0.1, "spread": 0.3}
    )
    assert section.planning_max_s == pytest.approx(0.4)
    planning = section.build(SETUP, np.random.default_rng(1))
    times_s = [planning.planning_s(k / 10) for k in range(400)]
    assert min(times_s) == pytest.approx(0.1, abs=0.01)
    assert max(times_s) == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize(
    "fields", [{"delay": -0.1}, {"jitter": -1}, {"spread": 11}, {"loss": 1.5}, {"loss": -0.1}]
)
def test_a_radio_that_cannot_be_is_refused(fields):
    with pytest.raises(ValueError, match=next(iter(fields))):
        radio(**fields)
