"""The limits of an experiment, and the checks before it is run."""

from tetractl.experiment.controller import Square
from tetractl.experiment.experiment import Experiment
from tetractl.run.square import check_square


def limits(experiment: Experiment) -> dict[str, str]:
    """Return the limits of a trial by name, as text for people."""
    control, unit = experiment.controller, experiment.units.length
    steps = control.steps_max + 1
    longest = steps * control.period
    fastest = max(robot.speed for robot in experiment.robots)
    found = {
        "control period": f"{control.period:g} s",
        "control steps of a trial": f"at most {steps}",
        "duration of a trial": f"at most {longest:g} s after the first command",
        "path of a robot": f"at most {fastest * longest:g} {unit}",
    } | control.bounds()
    if isinstance(control.first_plan, Square):
        square = control.first_plan
        found["before step 0"] = f"{square.laps} squares of {4 * square.side:g} s"
    return found | experiment.plant.bounds()


def check(experiment: Experiment) -> None:
    """Raise SpecError for a spec that cannot work, where only the computed motion shows it."""
    first = experiment.controller.first_plan
    if isinstance(first, Square):
        check_square(experiment, first)
