"""Tests of the fields of a simulation: what they refuse, and what they say of themselves."""

import math
from dataclasses import replace

import pytest
from pydantic import ValidationError
from testkit.trials import experiment

from tetractl.core.clock import VirtualClock
from tetractl.plant.sim_section import POSES_MAX, SimSection

ON_WHEELS = experiment(wheels={"radius": 40}).setup  # three robots, a period of 0.2 s
WITHOUT_WHEELS = experiment().setup


def problems(setup, **fields):
    """The fields of a section that contradict a setup."""
    return [loc for loc, _ in SimSection(**fields).contradictions(setup)]


@pytest.mark.parametrize("rates", [(120, 120), (120, 960), (1, 1)])
def test_the_truth_may_be_as_coarse_as_the_camera_but_not_coarser(rates):
    camera_hz, truth_hz = rates
    assert SimSection(camera_rate=camera_hz, truth_rate=truth_hz).truth_rate == truth_hz
    if camera_hz > 1:
        with pytest.raises(ValidationError, match="as high as camera_rate"):
            SimSection(camera_rate=camera_hz, truth_rate=camera_hz - 0.1)


@pytest.mark.parametrize(
    "fields",
    [{"camera_rate": 0.9}, {"dead_time": -0.1}, {"lost_commands": 1.1}, {"a_error": -0.1}],
)
def test_a_simulation_that_cannot_be_is_refused(fields):
    with pytest.raises(ValidationError):
        SimSection(**fields)


@pytest.mark.parametrize(
    ("fields", "disturbed"),
    [
        ({}, False),
        ({"motion": "euler"}, False),
        ({"camera_rate": 30, "truth_rate": 30}, False),
        ({"measurement_noise": {"position": 1.0}}, True),
        ({"measurement_noise": {"heading": 0.1}}, True),
        ({"measurement_noise": {"position": 0.0, "heading": 0.0}}, False),
        ({"heading_noise": 0.1}, True),
        ({"dead_time": 0.1}, True),
        ({"lost_commands": 0.1}, True),
        ({"a_error": 0.1}, True),
        ({"speed_error": 0.1}, True),
        ({"drive": {}}, True),
        ({"cells": {}}, True),
        ({"disturbances": [{"type": "radio"}]}, True),
    ],
)
def test_any_difference_from_the_papers_equations_counts_as_a_disturbance(fields, disturbed):
    assert SimSection.model_validate(fields).disturbed is disturbed


@pytest.mark.parametrize(
    ("disturbances", "loses"),
    [
        ([], False),
        ([{"type": "radio"}], False),
        ([{"type": "frame-loss", "share": 0.1}], True),
        ([{"type": "frame-loss", "share": 0.1}, {"type": "radio"}], True),
        ([{"type": "radio"}, {"type": "frame-loss", "share": 0.1}], True),
    ],
)
def test_a_simulation_loses_frames_if_any_disturbance_does(disturbances, loses):
    assert SimSection.model_validate({"disturbances": disturbances}).loses_frames is loses


def test_the_number_of_poses_in_a_period_is_limited_for_all_robots_together():
    setup = WITHOUT_WHEELS
    at_most_hz = POSES_MAX / (setup.period_s * len(setup.names))
    assert at_most_hz > 100_000, "so only a long period can exceed it"
    slow = replace(setup, period_s=setup.period_s * at_most_hz / 100_000)
    assert problems(slow, truth_rate=100_000) == []
    assert problems(slow, truth_rate=99_999, camera_rate=5_000) == []
    slower = replace(slow, period_s=slow.period_s * 1.001)
    assert problems(slower, truth_rate=100_000) == [("truth_rate",)]


def test_a_drive_needs_wheels_and_excludes_cells():
    assert problems(ON_WHEELS, drive={}) == []
    assert problems(WITHOUT_WHEELS, drive={}) == [("drive",)]
    assert problems(WITHOUT_WHEELS, cells={}) == []
    assert problems(ON_WHEELS, drive={}, cells={}) == [("cells",)]


@pytest.mark.parametrize(
    ("watchdog_s", "drive", "refused"),
    [
        (math.inf, None, False),
        (0.21, None, False),
        (0.2, None, True),  # one command every 0.2 s
        (0.1, None, True),
        (0.1, {"rate": 50}, False),
        (0.021, {"rate": 50}, False),
        (0.02, {"rate": 50}, True),
        (0.1, {}, True),
    ],
)
def test_a_watchdog_must_outlast_the_time_between_two_commands(watchdog_s, drive, refused):
    setup = replace(ON_WHEELS, watchdog_s=watchdog_s)
    assert (("drive",) in problems(setup, drive=drive)) is refused


def test_each_trial_has_a_virtual_clock_of_its_own():
    section = SimSection()
    assert isinstance(section.clock(), VirtualClock)
    assert section.clock() is not section.clock()
