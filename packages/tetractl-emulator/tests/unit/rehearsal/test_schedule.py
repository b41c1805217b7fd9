"""The draw of days: every row can be drawn and is a valid script, and a third have one fault."""

from collections import Counter
from random import Random

import pytest
from support.paths import ROOT
from tetractl_emulator.rehearsal.day import DayPlan, plan_of_day
from tetractl_emulator.rehearsal.participants import rehearsal_of
from tetractl_emulator.rehearsal.schedule import KINDS, faults_of_day
from tetractl_emulator.script import script_of

from tetractl.experiment.load import load_spec

NAMES = ("green", "blue", "red")
EXPERIMENT = load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml").experiment
SETUP = EXPERIMENT.setup
LAB = rehearsal_of(EXPERIMENT.lab, SETUP)


def test_a_day_depends_on_its_number_and_the_seed_alone():
    one, again = (plan_of_day(7, 12, SETUP, LAB) for _ in range(2))
    assert one == again
    assert one != plan_of_day(7, 13, SETUP, LAB)
    assert one != plan_of_day(8, 12, SETUP, LAB)


def test_every_day_is_a_valid_script_and_every_fault_is_met_often():
    random, counts, met = Random(1), Counter(), Counter()
    for day in range(3000):
        faults = faults_of_day(random, NAMES)
        counts[len(faults)] += 1
        met.update(fault["kind"] for fault in faults)
        if day % 10 == 0:
            plan = plan_of_day(1, day, SETUP, LAB)
            assert len(script_of(plan.script(), "optitrack", "m3pi-xbee").faults) == len(
                plan.faults
            )
    assert counts[1] / 3000 == pytest.approx(1 / 3, abs=0.03)
    assert max(counts) == 6
    assert min(met[kind.name] for kind in KINDS) > 15  # of 20 000 days: 100


def test_a_script_is_in_the_order_of_time_without_what_only_the_draw_has():
    faults = [
        {"kind": "killed", "strength": 0.3, "fault": "signal", "signal": "KILL", "at": 4.0},
        {"kind": "untracked", "strength": 0.95, "fault": "untracked", "robot": "red", "at": 2.0},
    ]
    script = DayPlan(1, {}, faults, "").script()
    assert script["about"] == "untracked, killed"
    assert script["faults"][1] == {"fault": "signal", "signal": "KILL", "at": 4.0}


def test_names_of_rows_are_unique():
    assert len({kind.name for kind in KINDS}) == len(KINDS)
