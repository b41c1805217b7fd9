"""Runs every controller on every instance of experiments/benchmark, with the same seeds.

    python benchmarks/instances.py                      100 trials each, into logs/benchmark
    python benchmarks/instances.py --trials 20 --only paper,cells
    python benchmarks/instances.py --ours               only the recommended controller
    python benchmarks/instances.py --report             print the page of the results so far

For each instance, the script writes a study and runs `tetractl study`, so an interrupted run can be
continued. Without --seed, the seed is the date of the last commit as a number, such as 20261130.
Nobody chooses this seed, and no rule of the controller was tuned with it. A folder keeps its seed.

Everything is simulated. The rows appear in docs/reference/benchmark.md. `tetractl stats` prints
more about each folder.

Above each table is a simple lower bound of a trial's time: the time in which the slowest robot
drives straight to the accepted error. The bound uses the spec's starts and speeds. Disturbances
change both, so a trial may take less time. The column after the time is its ratio to the bound.
"""

import argparse
import csv
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from solverbench.problems import EXPERIMENTS
from solverbench.report import print_progress

from tetractl.control.methods.mpc_section import RecommendedMpc
from tetractl.core.poses import Floats
from tetractl.spec.experiment import Experiment
from tetractl.spec.load import load_spec
from tetractl.statistics.estimate import distributions, proportion_interval
from tetractl.statistics.mean_difference import paired_t

SETTING = Mapping[str, Any]
OURS = "recommended"


def controllers(name: str) -> dict[str, SETTING]:
    """Return the arms of an instance. The first arm is the controller in its spec."""
    spec = instance(name)
    limit = 5 * spec.controller.time_limit
    settings_of: dict[str, SETTING] = {OURS: {}, "published": published(name)}
    settings_of["ensemble"] = {"controller": {"type": "ensemble", "time_limit": limit}}
    if len(spec.robots) == 1:
        margin = spec.controller.collision.margin  # pyright: ignore[reportAttributeAccessIssue]
        settings_of["rrt"] = {"controller": {"type": "rrt", "time_limit": limit, "margin": margin}}
    return settings_of


def published(name: str) -> SETTING:
    """Return the arm with the controller exactly as published, for an instance.

    Period, longest sequence, weight of obstacles and time limit come from the instance. k_max is
    the last step within this limit.
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
    """Compute a lower bound of a trial's time [s].

    Each robot drives on a straight line from its start in the spec, at the speed in the spec, until
    it is as near to its target as the accepted total error of all robots.
    """
    setup = spec.setup
    accept = getattr(spec.controller, "accept_error", 0.0)
    gaps = np.linalg.norm(setup.targets - setup.starts.xy, axis=1)
    return float(np.max((gaps - accept) / setup.speed))


def seed_of_last_commit() -> int:
    """Return the date of the repository's last commit as a number, such as 20261130."""
    command = ["git", "log", "-1", "--format=%cd", "--date=format:%Y%m%d"]
    folder = Path(__file__).parent
    return int(subprocess.run(command, cwd=folder, check=True, capture_output=True).stdout)


def study_text(name: str, title: str, arms: Mapping[str, SETTING], trials: int, seed: int) -> str:
    """Create the YAML text of an instance's study."""
    study = {
        "name": title,
        "base": str(EXPERIMENTS / "benchmark" / f"{name}.yaml"),
        "controllers": {arm: dict(settings) for arm, settings in arms.items()},
        "trials": {"count": trials, "seed": seed},
    }
    return yaml.safe_dump(study, sort_keys=False)


def run(
    name: str, out: Path, arms: Mapping[str, SETTING], trials: int, jobs: int, seed: int | None
) -> int:
    """Write the study of an instance, run its missing trials, and return the exit code.

    Without a `seed`, a study that was already begun keeps its own.
    """
    study = out.with_name(f"{out.name}.yaml")
    if seed is None:
        seed = seed_of(study) if study.exists() else seed_of_last_commit()
    study.write_text(study_text(name, out.name, arms, trials, seed), encoding="utf-8")
    command = ["-m", "tetractl", "study", study, "--out", out]
    return subprocess.run([sys.executable, *command, "--jobs", str(jobs)]).returncode


def seed_of(study: Path) -> int:
    """Return the seed in the file of a study."""
    return yaml.safe_load(study.read_text(encoding="utf-8"))["trials"]["seed"]


Row = dict[str, str]
"""A trial, as a row of a study's trials.csv."""


def trials_by_arm(folder: Path) -> dict[str, list[Row]]:
    """Read the valid trials of each arm from a study's folder."""
    rows: dict[str, list[Row]] = {}
    with (folder / "trials.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            if row["counted"] == "true":
                rows.setdefault(row["arm"], []).append(row)
    return rows


HEAD = (
    "controller",
    "n",
    "total error, mean and 95 % interval",
    "more than recommended, pairs",
    "entered",
    "left the arena",
    "trial [s]",
    "over the bound",
)


def table(rows_of: Mapping[str, Sequence[Row]], least_s: float) -> list[str]:
    """Create the lines of an instance's table. `least_s` is the lower bound from `bound_s`."""
    column = next(key for key in rows_of[OURS][0] if key.startswith("total_error_"))
    ours = _errors(rows_of[OURS], column)
    lines = [f"| {' | '.join(HEAD)} |", f"|{'---|' * len(HEAD)}"]
    for name, rows in rows_of.items():
        errors = _errors(rows, column)
        n = len(rows)
        pairs = sorted(errors.keys() & ours.keys()) if name != OURS else []
        differences = np.array([errors[trial] - ours[trial] for trial in pairs])
        time_s = float(np.mean([float(row["duration_s"]) for row in rows]))
        cells = [
            f"`{name}`",
            f"{n}",
            f"{_mean(np.array(list(errors.values())))} {column.rpartition('_')[2]}",
            _more(differences),
            _share(sum(row["entered_obstacle"] == "true" for row in rows), n),
            _share(sum(row["outside_arena"] == "true" for row in rows), n),
            f"{time_s:.1f}",
            f"{time_s / least_s:.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _errors(rows: Sequence[Row], column: str) -> dict[int, float]:
    """Return the values of a column, by the trial's index."""
    return {int(row["trial"]): float(row[column]) for row in rows}


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
            least_s = bound_s(spec)
            seed = seed_of(folder / f"{name}.yaml")
            bound = f"Lower bound of a trial's time: {least_s:.2f} s. Seed: {seed}."
            lines = table(trials_by_arm(folder / name), least_s)
            print("\n".join([f"### `{name}`", "", spec.description, "", bound, "", *lines, ""]))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    all_names = sorted(path.stem for path in (EXPERIMENTS / "benchmark").glob("*.yaml"))
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, help="of all trials [the day of the last commit]")
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
            print_progress(name)
            arms_run = {OURS: {}} if options.ours else controllers(name)
            out = options.out / name
            run(name, out, arms_run, options.trials, options.jobs, options.seed)
    report(options.out, names)


if __name__ == "__main__":
    main()
