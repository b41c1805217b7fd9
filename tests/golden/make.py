"""Writes the golden logs of the current format version, once, when the version is released.

    python tests/golden/make.py

Never run it again for a version whose logs are stored here. They show what its writer wrote, and
readers of every later version must give the values in the .json files beside them. The lab's log
comes from no real trial. All its numbers are random, so it can be read, but `verify` refuses it.
"""

import json
import sys
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER.parent))

from testkit.random_trials import trial, write  # noqa: E402

from tetractl.core.trial import Step  # noqa: E402
from tetractl.log import provenance  # noqa: E402
from tetractl.log.format.channels import FORMAT_VERSION  # noqa: E402
from tetractl.log.read.reader import read_trial  # noqa: E402
from tetractl.log.read.trial_log import TrialLog  # noqa: E402
from tetractl.run.interrupt import Interrupt  # noqa: E402
from tetractl.run.logged_trial import log_path, run_logged  # noqa: E402
from tetractl.spec.load import parse_spec  # noqa: E402

SPEC = """
name: golden
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: one, start: [100, 500], target: [300, 450], a: 6, speed: 200}
  - {name: two, start: [100, 300], target: [300, 350], a: 3, speed: 150}
obstacles: [{type: circle, center: [250, 400], radius: 20}]
wheels: {radius: 40}
controller: {type: pso-mpc, horizon_max: 6, steps_max: 4, optimizer: {particles: 4, iterations: 12}}
plant: {type: sim, camera_rate: 20, measurement_noise: {position: 1}, heading_noise: 0.1}
trials: {count: 3, seed: 7}
"""


def values_of_step(step: Step) -> dict[str, object]:
    return {
        "k": step.k,
        "frame": step.observation.frame,
        "signals": step.plan.signals.tolist(),
        "cost": step.plan.cost,
        "chosen": step.plan.chosen,
        "generator": str(step.plan.generator),
        "evaluations": [search.evaluations for search in step.plan.searches],
        "histories": [search.history.tolist() for search in step.plan.searches],
        "path_end": step.plan.path[-1, :, :2].tolist(),
        "solve_ns": step.solve_ns,
    }


def values(log: TrialLog) -> dict[str, object]:
    """What every later reader must give, as JSON keeps it: floats by their shortest digits."""
    result = log.result
    return {
        "run": [log.experiment.name, log.start.trial, log.start.seed, log.start.plant.simulated],
        "frames": log.frames.tolist(),
        "mocap_ns": log.mocap_ns.tolist(),
        "mocap": log.mocap.tolist(),
        "valid": log.valid.tolist(),
        "truth": None if log.truth is None else log.truth.tolist(),
        "commands": [[c.direction, c.sent_ns, list(c.delivered)] for c in log.commands],
        "steps": [values_of_step(step) for step in log.steps],
        "result": None
        if result is None
        else [result.outcome.value, result.steps, result.total_error, list(result.robot_errors)],
        "digest": log.digest,
        "damaged": log.damage is not None,
    }


def main() -> None:
    provenance.environment = lambda: "{}\n"
    name = f"format-{FORMAT_VERSION}"
    sim = FOLDER / f"{name}-sim.mcap"
    lab = FOLDER / f"{name}-lab.mcap"
    torn = FOLDER / f"{name}-torn.mcap"
    run_logged(parse_spec(SPEC, "golden.yaml"), FOLDER, 1, (), Interrupt())
    log_path(FOLDER, 1).rename(sim)
    of_lab = trial(3, robots=2, steps=5, simulated=False, first=3, iterations=4, length=5)
    write(of_lab, lab)
    torn.write_bytes(sim.read_bytes()[:-9000])
    logs = {path.name: read_trial(path) for path in (sim, lab, torn)}
    expected = {file_name: values(log) for file_name, log in logs.items()}
    (FOLDER / f"{name}.json").write_text(json.dumps(expected, indent=None) + "\n")


if __name__ == "__main__":
    main()
