"""Tests of sampled days: every fault can occur, all scripts are valid, a third have one fault."""

import math
from collections import Counter
from random import Random

import pytest
from testkit.paths import ROOT
from tetractl_emulator.rehearsal.day_plan import (
    BLIND_FRACTION,
    BLIND_S,
    FACING_DISTANCES,
    FACING_FRACTION,
    SHORT_FRACTION,
    DayPlan,
    faults_of_day,
    plan_of_day,
    rows_of,
)
from tetractl_emulator.script import parse_script

from tetractl.spec.load import load_spec
from tetractl.spec.yaml.core_yaml import format_yaml

NAMES = ("green", "blue", "red")
SPEC = ROOT / "experiments" / "three_m3pi_lab.yaml"
EXPERIMENT = load_spec(SPEC).experiment
LAB = (EXPERIMENT.lab, EXPERIMENT.setup)
ROWS = rows_of(*LAB)


def test_a_day_depends_on_its_number_and_the_seed_alone():
    first_plan, again = (plan_of_day(7, 12, *LAB) for _ in range(2))
    assert first_plan == again
    assert first_plan != plan_of_day(7, 13, *LAB)
    assert first_plan != plan_of_day(8, 12, *LAB)


def test_a_day_without_faults_is_as_the_spec_allows():
    plan = plan_of_day(7, 1, *LAB, with_faults=False)
    assert not plan.faults
    starts = EXPERIMENT.setup.starts
    for robot, x, y in zip(plan.emulation["robots"], starts.x, starts.y, strict=True):
        assert math.dist(robot["start"], (x, y)) < EXPERIMENT.lab.limits.start_mm


def test_some_trials_are_short_and_some_robots_are_driven_blindly_by_settings_of_the_spec():
    settings = [plan_of_day(1, day, *LAB).settings for day in range(400)]
    blind = [text for text, *_ in filter(None, settings) if "sequence" in text]
    short = [text for text, *_ in filter(None, settings) if "time_limit" in text]
    assert len(blind) == pytest.approx(400 * BLIND_FRACTION, abs=20)
    assert len(short) == pytest.approx(400 * SHORT_FRACTION, abs=20)
    assert len(blind) + len(short) == len(list(filter(None, settings)))
    control = load_spec(SPEC, [blind[0]]).experiment.controller
    assert len(control.directions) * control.period == pytest.approx(BLIND_S)
    assert 2.0 <= load_spec(SPEC, [short[0]]).experiment.controller.time_limit <= 8.0
    script = DayPlan(1, {}, [], (short[0],)).script()
    assert script["runner"] == {"set": [short[0]]}
    parsed = parse_script(format_yaml(script), "day.yaml", "optitrack", "m3pi-xbee")
    assert parsed.runner == {"set": (short[0],)}


def test_on_half_of_the_blind_days_two_robots_start_face_to_face():
    """The first direction is the heading of one: it drives ahead, and the other has to turn round.
    Each pair is drawn, and the third robot stands as in the spec."""
    separation = EXPERIMENT.lab.limits.separation_mm
    as_in_the_spec = EXPERIMENT.setup.starts.array()
    blind = 0
    pairs = Counter()
    for day in range(1000):
        settings = plan_of_day(1, day, *LAB).settings
        if not settings or "sequence" not in settings[0]:
            continue
        blind += 1
        experiment = load_spec(SPEC, settings).experiment
        starts = experiment.setup.starts.array()
        moved = tuple(i for i in range(3) if (starts[i] != as_in_the_spec[i]).any())
        pairs[moved] += 1
        if moved:
            first, second = starts[list(moved)]
            apart = math.dist(first[:2], second[:2]) / separation
            assert FACING_DISTANCES[0] <= apart <= FACING_DISTANCES[1]
            assert math.cos(first[2] - second[2]) == pytest.approx(-1)
            ahead_rad = experiment.controller.directions[0]
            assert any(math.isclose(ahead_rad, robot[2], abs_tol=0.01) for robot in (first, second))
    assert pairs[()] / blind == pytest.approx(1 - FACING_FRACTION, abs=0.15)
    assert pairs.keys() == {(), (0, 1), (0, 2), (1, 2)}


@pytest.mark.long
def test_every_tenth_day_is_a_valid_script():
    for day in range(0, 3000, 10):
        plan = plan_of_day(1, day, *LAB)
        script = parse_script(format_yaml(plan.script()), "day.yaml", "optitrack", "m3pi-xbee")
        assert len(script.faults) == len(plan.faults)


@pytest.mark.long
def test_every_fault_is_drawn_often_and_its_strongest_lasts():
    random = Random(1)
    counts = Counter()
    met = Counter()
    lasting = Counter()
    for _ in range(20_000):
        faults = faults_of_day(random, NAMES, ROWS)
        counts[len(faults)] += 1
        met.update({fault["kind"] for fault in faults})
        lasting.update(fault["kind"] for fault in faults if "for" not in fault)
    assert counts[1] / 20_000 == pytest.approx(1 / 3, abs=0.01)
    assert max(counts) == 6
    assert {kind.name for kind in ROWS} == met.keys()
    assert min(met.values()) >= 100
    fixed = {kind.name for kind in ROWS if "for" in kind.fields}
    assert lasting.keys() == met.keys() - fixed
    assert min(lasting.values()) >= 10


def test_a_script_is_in_the_order_of_time_without_what_only_the_draw_has():
    faults = [
        {"kind": "killed", "fault": "signal", "signal": "KILL", "at": 4.0},
        {"kind": "untracked", "fault": "untracked", "robot": "red", "at": 2.0},
    ]
    script = DayPlan(1, {}, faults).script()
    assert script["about"] == "untracked, killed"
    assert script["faults"][1] == {"fault": "signal", "signal": "KILL", "at": 4.0}
