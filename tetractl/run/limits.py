"""The limits of an experiment, and the checks before it is run."""

from tetractl.experiment.controller import Square, SwarmSpec
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab import LabSpec, Slave
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
        "horizons at step 0": f"1 ... {control.horizon_max} signals",
    }
    if isinstance(control.swarm, SwarmSpec):
        most = (control.swarm.iterations + 1) * control.swarm.particles + 1
        found["cost evaluations of a horizon"] = f"at most {most}"
    if isinstance(control.first_plan, Square):
        square = control.first_plan
        found["before step 0"] = f"{square.laps} squares of {4 * square.side:g} s"
    return found | (_in_lab(experiment.plant) if isinstance(experiment.plant, LabSpec) else {})


def _in_lab(lab: LabSpec) -> dict[str, str]:
    limits = lab.limits
    cap = min(robot.limit for robot in lab.robots)
    if isinstance(lab.protocol, Slave):
        cap = min(cap, lab.protocol.limit)
    return {
        "cameras": f"{lab.mocap.server}:{lab.mocap.command_port}, {lab.mocap.transport}",
        "radio": f"{lab.radio.port}, {lab.radio.rate:g} commands a second",
        "wheel counts": f"at most {cap} of 127",
        "all robots stop": f"{limits.stale:g} s after the last camera frame",
        "a robot stops": f"{limits.untracked_stop:g} s after it was last tracked",
        "the trial aborts": (
            f"{limits.stream_lost:g} s after the last frame, {limits.untracked_abort:g} s after a "
            f"robot was last tracked, or {limits.late_steps} late control steps in a row"
        ),
    }


def check(experiment: Experiment) -> None:
    """Raise SpecError for a spec that cannot work, where only the computed motion shows it."""
    first = experiment.controller.first_plan
    if isinstance(first, Square):
        check_square(experiment, first)
