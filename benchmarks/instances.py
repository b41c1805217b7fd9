"""Run every controller on every instance of experiments/benchmark, with the same seeds.

    python benchmarks/instances.py                      100 trials each, into logs/benchmark
    python benchmarks/instances.py --trials 20 --only paper,cells
    python benchmarks/instances.py --ours               the recommended controller alone
    python benchmarks/instances.py --report             print the page of what there is

For each instance it writes a study and runs `tetractl study`, so it goes on where it was stopped.
Everything is simulated. The rows are those of docs/reference/benchmark.md; `tetractl stats` says
more of each folder.

Above each table is the plainest lower bound of a trial's time: the robot that needs most drives
straight to the accepted error at its speed. It is by the spec's starts and speeds; disturbances
change both, so that a trial may take less. The column after the time is its ratio to this.
"""

import argparse
import csv
import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from solverbench.problems import EXPERIMENTS
from solverbench.report import progress

from tetractl.control.mpc_section import RecommendedMpc
from tetractl.core.poses import Floats
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import load_spec
from tetractl.results.estimate import distributions, proportion_interval
from tetractl.results.mean_difference import holm, paired_t, signed_rank

SETTING = Mapping[str, Any]
OURS = "recommended"


def controllers(name: str) -> dict[str, SETTING]:
    """Return the arms of an instance; the first is the one in its spec."""
    spec = instance(name)
    limit = 5 * spec.controller.time_limit
    settings_of: dict[str, SETTING] = {OURS: {}, "published": published(name)}
    settings_of["ensemble"] = {"controller": {"type": "ensemble", "time_limit": limit}}
    if len(spec.robots) == 1:
        margin = spec.controller.collision.margin  # pyright: ignore[reportAttributeAccessIssue]
        settings_of["rrt"] = {"controller": {"type": "rrt", "time_limit": limit, "margin": margin}}
    return settings_of


def published(name: str) -> SETTING:
    """Return the arm of the controller exactly as published, in the place of an instance's.

    Its period, longest sequence, weight of obstacles and time limit are the instance's, and k_max
    is the last step within this limit.
    """
    ours = instance(name).controller
    assert isinstance(ours, RecommendedMpc)
    section = {
        "type": "pso-mpc",
        "period": ours.period,
        "horizon_max": ours.horizon_max,
        "obstacle_weight": ours.obstacle_weight,
        "steps_max": round(ours.time_limit / ours.period) - 1,  # a trial has one step more
    }
    return {"controller": section}


def instance(name: str) -> Experiment:
    return load_spec(EXPERIMENTS / "benchmark" / f"{name}.yaml").experiment


def bound_s(spec: Experiment) -> float:
    """Return the least time [s] in which each robot of a spec could come as near to its target as
    is accepted of all, on a straight line from its start, if starts and speeds are the spec's."""
    setup = spec.setup
    accept = getattr(spec.controller, "accept_error", 0.0)
    gaps = np.linalg.norm(setup.targets - setup.starts.xy, axis=1)
    return float(np.max((gaps - accept) / setup.speed))


def study_text(name: str, title: str, arms: Mapping[str, SETTING], trials: int) -> str:
    """Return the YAML text of an instance's study."""
    study = {
        "name": title,
        "base": str(EXPERIMENTS / "benchmark" / f"{name}.yaml"),
        "controllers": {arm: dict(settings) for arm, settings in arms.items()},
        "trials": {"count": trials, "seed": 1},
    }
    return yaml.safe_dump(study, sort_keys=False)


def run(name: str, out: Path, arms: Mapping[str, SETTING], trials: int, jobs: int) -> int:
    """Write the study of an instance and run what it lacks; return its exit code."""
    study = out.with_name(f"{out.name}.yaml")
    study.write_text(study_text(name, out.name, arms, trials), encoding="utf-8")
    command = ["-m", "tetractl", "study", study, "--out", out, "--logs", "none"]
    return subprocess.run([sys.executable, *command, "--jobs", str(jobs)]).returncode


@dataclass(frozen=True)
class Arm:
    """The trials of one controller on one instance, by number."""

    name: str
    unit: str
    errors: dict[int, float]
    entered: int
    left_arena: int
    seconds: float
    solving_s: float


def arms(folder: Path) -> list[Arm]:
    """Return the arms of a study's folder, with the trials that count."""
    rows: dict[str, list[dict[str, str]]] = {}
    for row in _read(folder / "trials.csv"):
        if row["counted"] == "true":
            rows.setdefault(row["arm"], []).append(row)
    step_ms: dict[str, list[float]] = {}
    for row in _read(folder / "times.csv"):
        step_ms.setdefault(row["arm"], []).append(float(row["solve_mean_ms"]))
    return [_arm(name, rows_of_arm, step_ms[name]) for name, rows_of_arm in rows.items()]


def _read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def _arm(name: str, rows: list[dict[str, str]], step_ms: list[float]) -> Arm:
    column = next(key for key in rows[0] if key.startswith("total_error_"))
    steps = np.mean([float(row["steps"]) for row in rows])
    return Arm(
        name,
        column.rpartition("_")[2],
        {int(row["trial"]): float(row[column]) for row in rows},
        sum(row["entered_obstacle"] == "true" for row in rows),
        sum(row["outside_arena"] == "true" for row in rows),
        float(np.mean([float(row["duration_s"]) for row in rows])),
        float(steps * np.mean(step_ms)) / 1e3,
    )


HEAD = (
    "controller",
    "n",
    "total error, mean and 95 % interval",
    "more than recommended, pairs",
    "p, Holm",
    "entered",
    "left the arena",
    "trial [s]",
    "over the bound",
    "solving [s]",
)


def _p_value(p: float) -> str:
    if math.isnan(p):
        return ""
    return f"{p:.1g}" if p >= 1e-4 else "< 0.0001"


def table(arms: Sequence[Arm], least_s: float) -> list[str]:
    """Return the lines of an instance's table; `least_s` is that of `bound_s`."""
    ours = next(arm for arm in arms if arm.name == OURS)
    against = [_differences(arm, ours) for arm in arms]
    p_values = holm([signed_rank(d) if len(d) else math.nan for d in against])
    lines = [f"| {' | '.join(HEAD)} |", f"|{'---|' * len(HEAD)}"]
    for arm, differences, p in zip(arms, against, p_values, strict=True):
        errors = np.array(list(arm.errors.values()))
        n = len(errors)
        cells = [
            f"`{arm.name}`",
            f"{n}",
            f"{_mean(errors)} {arm.unit}",
            _more(differences),
            _p_value(p),
            _share(arm.entered, n),
            _share(arm.left_arena, n),
            f"{arm.seconds:.1f}",
            f"{arm.seconds / least_s:.2f}",
            f"{arm.solving_s:.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _differences(arm: Arm, ours: Arm) -> Floats:
    shared_names = arm.errors.keys() & ours.errors.keys() if arm is not ours else set()
    return np.array([arm.errors[trial] - ours.errors[trial] for trial in sorted(shared_names)])


def _mean(errors: Floats) -> str:
    (distribution,) = distributions(errors[None])
    if not distribution.ci95.known:
        all_alike = distribution.std < 1e-9 * distribution.mean
        return f"{distribution.mean:.3g} [{'all alike' if all_alike else 'n too small'}]"
    return f"{distribution.mean:.3g} [{distribution.ci95.low:.3g}, {distribution.ci95.high:.3g}]"


def _more(differences: Floats) -> str:
    if not len(differences):
        return ""
    difference = paired_t(differences)
    return f"{difference.value:.3g} [{difference.ci95.low:.3g}, {difference.ci95.high:.3g}]"


def _share(count: int, n: int) -> str:
    interval = proportion_interval(count, n)
    return f"{count} [{100 * interval.low:.0f}, {100 * interval.high:.0f} %]"


def report(folder: Path, names: Sequence[str]) -> None:
    """Print the page of results."""
    for name in names:
        if (folder / name / "trials.csv").exists():
            spec = instance(name)
            lines = table(arms(folder / name), bound_s(spec))
            print("\n".join([f"### `{name}`", "", spec.description, "", *lines, ""]))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    all_names = sorted(path.stem for path in (EXPERIMENTS / "benchmark").glob("*.yaml"))
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--only", default=",".join(all_names), help="instances, such as paper,cells"
    )
    parser.add_argument("--out", type=Path, default=Path("logs/benchmark"))
    parser.add_argument("--ours", action="store_true", help=f"run `{OURS}` alone")
    parser.add_argument("--report", action="store_true", help="print what there is; run nothing")
    options = parser.parse_args()
    names = options.only.split(",")
    unknown = [name for name in names if name not in all_names]
    if unknown:
        parser.error(f"--only: no instance {unknown[0]}; there are {', '.join(all_names)}")
    if not options.report:
        options.out.mkdir(parents=True, exist_ok=True)
        for name in names:
            progress(name)
            arms_run = {OURS: {}} if options.ours else controllers(name)
            run(name, options.out / name, arms_run, options.trials, options.jobs)
    report(options.out, names)


if __name__ == "__main__":
    main()
