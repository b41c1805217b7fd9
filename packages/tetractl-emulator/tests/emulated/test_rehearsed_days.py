"""Tests of rehearsals in which each fault of the table occurs at least once.

If a night of rehearsals with new seeds finds a defect, a script of its faults is added here.
"""

from random import Random

import pytest
from testkit.emulator.lab_processes import SPEC
from tetractl_emulator.lab_rehearse import rehearse_day
from tetractl_emulator.rehearsal import day_plan

from tetractl.control.methods.build import warm_up
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

pytestmark = [pytest.mark.system, pytest.mark.release]

SEED = 2
A_DAY = 3


def plans_of_each_fault(lab, setup):
    """Days of three faults that begin at one time, so that each is met; a kill has its own."""
    random = Random(SEED)
    rows = day_plan.rows_of(lab, setup)
    random.shuffle(rows)
    others = [row for row in rows if row.name != "killed"]
    groups = [others[i : i + A_DAY] for i in range(0, len(others), A_DAY)]
    groups.append([row for row in rows if row.name == "killed"])
    plans = []
    for number, group in enumerate(groups):
        faults = [day_plan.faults_of_day(random, setup.names, [row])[0] for row in group]
        at_once = [fault | {"since": "run", "at": 1.0} for fault in faults]
        plans.append(day_plan.DayPlan(number, {}, at_once))
    return plans


def test_days_on_which_each_fault_of_the_table_is_met_break_nothing(monkeypatch):
    experiment = select_plant(load_spec(SPEC), "emulated").experiment
    warm_up(experiment, print)
    plans = plans_of_each_fault(experiment.plant, experiment.setup)
    monkeypatch.setattr(day_plan, "plan_of_day", lambda seed, number, *_: plans[number])
    rows = [rehearse_day(SPEC, (), SEED, number) for number in range(len(plans))]
    assert {row["day"]: row["violations"] for row in rows if row["violations"]} == {}
    met = {kind for row in rows for kind, _ in row["met"]}
    assert {row.name for row in day_plan.rows_of(experiment.plant, experiment.setup)} - met == set()
