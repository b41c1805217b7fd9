"""Observes a day of robots or of cells: what truly happened, and which invariants it has broken."""

from collections.abc import Sequence

from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab_section import LabSection
from tetractl_emulator.rehearsal.day import Day
from tetractl_emulator.rehearsal.invariants import violations
from tetractl_emulator.rehearsal.truth import Truth
from tetractl_emulator.rehearsal.violation import Violation


def observed(
    day: Day, experiment: Experiment, lab: LabSection
) -> tuple[Truth, Sequence[Violation]]:
    """Return the truth of a day in a lab, and the invariants that it has broken."""
    if lab.actuator.type == "field":
        from tetractl_emulator.rehearsal.cell_invariants import DishTruth, cell_violations

        dish = DishTruth(day, experiment.setup)
        return dish, cell_violations(dish, lab)
    truth = Truth(day, experiment.setup)
    watchdog_s = (experiment.wheels.watchdog if experiment.wheels else None) or 0.25
    return truth, violations(truth, lab.limits, watchdog_s)
