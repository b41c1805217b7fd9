"""Tests of how the disc in which a robot is held is measured."""

from types import SimpleNamespace

import pytest
from tetractl_papers import khalil_2013
from tetractl_papers.khalil_2013 import measure_disc, measure_disc_ratio


def log_of(a, speed):
    facts = {"true_a": f"[{a}]", "true_speed": f"[{speed}]"}
    return SimpleNamespace(start=SimpleNamespace(plant=SimpleNamespace(facts=facts)))


def test_a_disc_is_compared_with_the_one_that_no_robot_can_beat(monkeypatch):
    """A robot that never stops is 2 v / a wide on the mean."""
    monkeypatch.setattr(khalil_2013, "discs", lambda log: [30.0])
    assert measure_disc(log_of(2.0, 5.0)) == 30
    assert measure_disc_ratio(log_of(2.0, 5.0)) == pytest.approx(30 / (2 * 5.0 / 2.0))
