"""Observes a day of robots or of cells: what truly happened, and which sentences it has broken."""

from collections.abc import Sequence

from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab_section import LabSection
from tetractl_emulator.rehearsal.day import Day
from tetractl_emulator.rehearsal.sentences import violations
from tetractl_emulator.rehearsal.truth import Truth
from tetractl_emulator.rehearsal.violation import Violation

WATCHDOG_S = 0.25  # of robots whose spec names none


def observed(
    day: Day, experiment: Experiment, lab: LabSection
) -> tuple[Truth, Sequence[Violation]]:
    """Return the truth of a day in a lab, and the sentences that it has broken."""
    watchdog_s = (experiment.wheels.watchdog if experiment.wheels else None) or WATCHDOG_S
    if lab.actuator.type == "field":
        from tetractl_emulator.rehearsal.cell_sentences import DishTruth, cell_violations

        dish = DishTruth(day, experiment.setup, lab.limits, watchdog_s)
        return dish, cell_violations(dish, lab)
    truth = Truth(day, experiment.setup, lab.limits, watchdog_s)
    return truth, violations(truth)
