"""Plans of days: what is drawn is within its limits, and the same for the same arguments."""

import math
from collections import Counter
from random import Random

import numpy as np
import pytest
from testkit.paths import ROOT
from tetractl_emulator.fault_rows import ENDLESS_STRENGTH, FaultRow, value_between
from tetractl_emulator.rehearsal.day_plan import (
    BLIND_FRACTION,
    BLIND_S,
    FACING_DISTANCES,
    NOT_IN_SCRIPT,
    SHORT_FRACTION,
    SHORT_S,
    SPAN_S,
    START_FRACTION,
    DayPlan,
    faults_of_day,
    plan_of_day,
    rows_of,
)

from tetractl.spec.load import load_spec

DAYS = 400
SEED = 552190


@pytest.fixture(scope="module")
def lab():
    experiment = load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml").experiment
    return experiment.lab, experiment.setup


@pytest.fixture(scope="module")
def plans(lab):
    return [plan_of_day(SEED, day, *lab) for day in range(DAYS)]


def of_settings(plans, start):
    return [plan for plan in plans if plan.settings and plan.settings[0].startswith(start)]


def test_a_plan_depends_on_its_arguments_alone(lab, plans):
    assert plan_of_day(SEED, 3, *lab) == plans[3]
    assert plan_of_day(SEED + 1, 3, *lab) != plans[3]
    assert len({plan.seed for plan in plans}) == DAYS


def test_a_day_has_one_fault_or_up_to_six_and_a_good_one_none(lab, plans):
    """A third have one: of 400 days, 133 with a standard deviation of 9.4."""
    counts = Counter(len(plan.faults) for plan in plans)
    assert set(counts) == {1, 2, 3, 4, 5, 6}
    assert counts[1] == pytest.approx(DAYS / 3, abs=38)
    good = plan_of_day(SEED, 3, *lab, with_faults=False)
    assert (good.faults, good.settings, good.script()["about"]) == ([], [], "no fault")


def test_each_fault_begins_and_ends_within_its_limits(lab, plans):
    rows = {row.name: row for row in rows_of(*lab)}
    for fault in (fault for plan in plans for fault in plan.faults):
        row = rows[fault["kind"]]
        most_s = {"start": 1.0, "stop": 0.5}.get(fault.get("since"), SPAN_S)
        assert 0 <= fault["at"] <= most_s
        assert fault["fault"] == row.fault
        if "for" in fault and "for" not in row.fields:
            assert 0.02 <= fault["for"] <= 16
            assert not row.at_once


def test_a_fault_ends_unless_it_is_of_a_moment_strong_or_has_a_time_of_its_own(lab, plans):
    rows = {row.name: row for row in rows_of(*lab)}
    faults = [fault for plan in plans for fault in plan.faults]
    lasting = [fault for fault in faults if not rows[fault["kind"]].at_once]
    usual = [fault for fault in lasting if "for" not in rows[fault["kind"]].fields]
    share = sum("for" in fault for fault in usual) / len(usual)
    assert share == pytest.approx(
        ENDLESS_STRENGTH, abs=4 * math.sqrt(ENDLESS_STRENGTH * (1 - ENDLESS_STRENGTH) / len(usual))
    )
    own = [fault["for"] for fault in lasting if fault["kind"] == "tracked at times"]
    assert own
    assert all(6 <= seconds <= 16 for seconds in own)


@pytest.mark.parametrize(("start", "stop"), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.2, 0.3)])
def test_a_row_states_how_often_its_fault_begins_at_the_start_or_the_stop(start, stop):
    row = FaultRow(
        "kind",
        "right",
        start_fraction=start,
        stop_fraction=stop,
        fields={"by": value_between(1, 2)},
    )
    random = Random(SEED)
    faults = [fault for _ in range(DAYS) for fault in faults_of_day(random, ["a", "b"], [row])]
    counts = Counter(fault.get("since") for fault in faults)
    total = len(faults)
    for since, share in (("start", start), ("stop", stop), (None, 1 - start - stop)):
        assert counts[since] / total == pytest.approx(share, abs=4 * math.sqrt(0.25 / total))


def test_a_script_has_the_faults_in_order_without_what_is_ours():
    faults = [
        {"kind": "late", "right": "x", "fault": "b", "at": 3.0},
        {"kind": "soon", "right": "x", "fault": "a", "at": 1.0},
        {"kind": "late", "right": "x", "fault": "b", "at": 5.0},
    ]
    script = DayPlan(1, {"robots": []}, faults).script()
    assert [fault["at"] for fault in script["faults"]] == [1.0, 3.0, 5.0]
    assert not any(key in fault for key in NOT_IN_SCRIPT for fault in script["faults"])
    assert script["about"] == "soon, late"
    assert "runner" not in script
    with_settings = DayPlan(1, {}, faults, ["trials.count=1"]).script()
    assert with_settings["runner"] == {"set": ["trials.count=1"]}


def test_some_days_are_short_and_some_are_driven_blindly(plans):
    """15 and 10 % of 400: 60 and 40, with standard deviations of 7.1 and 6.0."""
    short = of_settings(plans, "controller.time_limit=")
    assert len(short) == pytest.approx(SHORT_FRACTION * DAYS, abs=29)
    for plan in short:
        assert SHORT_S[0] <= float(plan.settings[0].partition("=")[2]) <= SHORT_S[1]
    assert len(of_settings(plans, "controller={")) == pytest.approx(BLIND_FRACTION * DAYS, abs=25)


def test_a_blind_day_holds_each_direction_for_about_a_second(lab, plans):
    _, setup = lab
    for plan in of_settings(plans, "controller={"):
        text = plan.settings[0].partition("directions: [")[2].partition("]")[0]
        directions = [float(word) for word in text.split(",")]
        held = round(1 / setup.period_s)
        assert len(directions) == BLIND_S * held
        assert np.ptp(np.reshape(directions, (BLIND_S, held)), axis=1).max() == 0
        assert max(map(abs, directions)) <= math.pi + 0.005


def test_two_robots_start_face_to_face_on_some_blind_days(lab, plans):
    """One faces the middle of the arena; the other is ahead of it and faces it."""
    section, setup = lab
    separation = section.limits.separation_mm / 1000 / setup.metres
    spec = setup.starts.array()
    found = 0
    for plan in of_settings(plans, "controller={"):
        values = [setting.partition("=")[2] for setting in plan.settings[1:]]
        xy = np.array([[float(v) for v in text.strip("[]").split(",")] for text in values[::2]])
        headings = np.array([float(text) for text in values[1::2]])
        moved = np.flatnonzero(np.abs(xy - spec[:, :2]).max(axis=1) > 1e-3)
        if not moved.size:
            continue
        found += 1
        (second,) = moved
        turned = np.flatnonzero(np.abs(headings - spec[:, 2]) > 1e-3).tolist()
        (first,) = [robot for robot in turned if robot != second]
        off = complex(*(xy[second] - xy[first]))
        assert FACING_DISTANCES[0] - 0.01 <= abs(off) / separation <= FACING_DISTANCES[1] + 0.01
        assert math.remainder(np.angle(off) - headings[first], math.tau) == pytest.approx(
            0, abs=0.01
        )
        assert abs(math.remainder(headings[second] - headings[first], math.tau)) == pytest.approx(
            math.pi, abs=0.001
        )
        for shape in setup.obstacles:
            assert shape.distance(*xy[second]) > setup.body_radius - 1e-3
    assert found > 5


def test_robots_are_put_near_the_starts_of_the_day(lab, plans):
    section, setup = lab
    near = START_FRACTION * section.limits.start_mm / 1000 / setup.metres
    offs = []
    for plan in plans:
        if of_settings([plan], "controller={"):
            continue
        for robot, (x, y, heading) in zip(
            plan.emulation["robots"], setup.starts.array().tolist(), strict=True
        ):
            off = math.hypot(robot["start"][0] - x, robot["start"][1] - y)
            assert off <= near + 0.01
            assert abs(robot["heading"] - heading) <= 0.0501
            offs.append(off)
    assert max(offs) > 0.95 * near
