"""Days of a fixed seed; what a night of new seeds finds becomes a script of faults."""

import pytest
from support.lab_processes import SPEC
from tetractl_emulator.lab_rehearse import rehearsed
from tetractl_emulator.rehearsal.day import rows_of

from tetractl.control.build import warm_up
from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import on_plant

pytestmark = [pytest.mark.system, pytest.mark.release]

SEED = 2
DAYS = (  # few on which each fault of the table is met
    *(1, 3, 4, 7, 8, 28, 63, 69, 75, 85, 100, 117, 123, 151, 181, 199, 200, 202, 217, 230, 289),
    *(322, 405, 407, 444),
)


def test_days_on_which_each_fault_of_the_table_is_met_break_nothing():
    experiment = on_plant(load_spec(SPEC), "emulated").experiment
    warm_up(experiment, print)
    rows = [rehearsed(SPEC, (), SEED, day) for day in DAYS]
    assert {row["day"]: row["violations"] for row in rows if row["violations"]} == {}
    met = {kind for row in rows for kind, _ in row["met"]}
    assert {row.name for row in rows_of(experiment.plant, experiment.setup)} - met == set()
