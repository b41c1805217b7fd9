"""Measure the closed loop where the controller's model may lack something.

    python benchmarks/unmodelled.py --world sides later-5hz --trials 30 --jobs 2 --out NEW
    python benchmarks/unmodelled.py --trials 0 --out NEW --against OLD

Everything is simulated; bodies are discs of the spec's radius; in `dead`, errors are those of the
other robots. --out keeps a CSV for each world, to which trials are added and from which the table
is printed; --against compares the same trials with another version's. Intervals are those of the
last estimates, counted where no misfit was said in the trial, with the root mean square of errors
over standard deviations, 1 if these are right; in brackets, in how many trials one of them missed,
and in how many of those a misfit was said. Times of steps are processor times of plans for moving
robots, which depend on the computer.
"""

import argparse
import csv
import time
from collections.abc import Sequence
from dataclasses import fields
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from solverbench.problems import played
from solverbench.report import load, progress
from worlds import WORLDS, Truth, Unmodelled

from tetractl.core.commands import Command
from tetractl.core.plan import End, Estimate, Outcome, Plan
from tetractl.core.poses import Floats, Observation
from tetractl.core.protocols import Controller, Plant
from tetractl.core.trial import Note, Step
from tetractl.experiment.experiment import Experiment
from tetractl.plant.disturbances.radio import RadioSection
from tetractl.plant.simulation import SimPlant
from tetractl.plant.wheel_drive import WheelDrive
from tetractl.plant.wheel_kernel import GAIN, TRUE_GAIN
from tetractl.results.estimate import distributions
from tetractl.results.mean_difference import paired_t
from tetractl.run.checked_controller import build_controller

QUANTITIES = {"a": "a", "side": "side", "speed": "speed", "dead_time": "dead time"}
"""Fields of an estimate, as far as it has them, and their names in the table."""
FAR_MM = 100.0  # a total error that no disturbance explains
MISFIT = "the model does not fit"
TOLD = "outcome"
Row = dict[str, Any]


class Timed:
    """A controller that notes the processor time of each plan for moving robots in `ms`."""

    def __init__(self, controller: Controller, ms: list[float]) -> None:
        self.controller = controller
        self.moving = False
        self.ms = ms

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        begin = time.thread_time()
        plan = self.controller.plan(observation, last_command, earlier)
        if self.moving:
            self.ms.append(1e3 * (time.thread_time() - begin))
        self.moving = isinstance(plan, Plan) and not plan.pauses
        return plan


class Noted:
    """An observer that keeps control steps, and what is said."""

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.texts: list[str] = []

    def on_step(self, step: Step) -> None:
        self.steps.append(step)

    def on_note(self, note: Note) -> None:
        self.texts.append(note.text)

    def __getattr__(self, name: str):  # on_start, on_command, on_samples, on_stop
        return lambda *_: None


def timed(ms: list[float], spec: Experiment, key: int, plant: Plant) -> Controller:
    """The spec's controller, whose times are noted."""
    return Timed(build_controller(spec, key), ms)


def run(seed: int, settings: Sequence[str], controller_asked: tuple[str, int]) -> Row:
    """Run one trial of a world in virtual time."""
    world, trial = controller_asked
    name, slow, _ = world.partition("-5hz")
    spec = WORLDS[name].spec(5 if slow else 20, seed, trial, settings)
    noted = Noted()
    ms = list[float]()
    result, plant = played(spec, trial, partial(timed, ms), [noted])
    assert isinstance(plant, SimPlant)
    truth = true(plant)
    verdict = result.verdict
    radius = spec.controller.body_radius
    errors = np.array(result.robot_errors)[truth["lives"]]
    steps = noted.steps
    return {
        "seed": seed,
        "trial": trial,
        "error": errors.sum(),
        "greatest": errors.max(),
        "seconds": result.duration_s,
        "complete": int(result.outcome.complete),
        TOLD: result.outcome.value + (f": {result.reason}" if result.reason else ""),
        "edge_mm": min(verdict.edge) - radius,
        "obstacle_mm": min(verdict.clearance) - radius,
        "apart_mm": min(verdict.apart) - radius - radius,
        "pauses": sum(step.plan.pauses for step in steps),
        "misfit": int(any(MISFIT in text for text in noted.texts)),
        "late_steps": sum(step_ms > 1e3 * spec.setup.period_s for step_ms in ms),
        "step_max_ms": max(ms, default=0.0),
        **held(steps[-1].plan.estimate if steps else None, truth),
    }


def true(plant: SimPlant) -> Truth:
    """Return what holds at the end of a trial; errors of wheels count as those of a and speed."""
    a, speed = plant.rates
    drives = speed != 0
    turns, translates = calibration(plant)
    radios = [
        disturbance
        for disturbance in plant.settings.disturbances
        if isinstance(disturbance, RadioSection)
    ]
    delay = sum(radio.delay + radio.jitter / 2 + radio.spread / 2 for radio in radios)
    truth_of_plant = {
        "a": turns * np.where(drives, a, plant.a),
        "speed": translates * np.where(drives, np.abs(speed), plant.speed),
        "side": np.zeros(len(a)),
        "dead_time": np.array([plant.settings.dead_time + delay]),
        "lives": np.ones(len(a), dtype=np.bool_),
    }
    for disturbance in plant.disturbances:
        if isinstance(disturbance, Unmodelled):
            truth_of_plant = disturbance.truth(truth_of_plant)
    return truth_of_plant


def calibration(plant: SimPlant) -> tuple[Floats, Floats]:
    """Return the factors (N,) by which the errors of gains and radii change turning rates and
    speeds: by (21)-(23) a robot turns by the mean gain over the radius, and a difference of its
    gains turns it at a constant rate besides, which is no part of a."""
    drive = plant.drive
    if not isinstance(drive, WheelDrive):
        ones = np.ones(len(plant.a))
        return ones, ones
    trains = drive.host.trains
    mean = (trains[TRUE_GAIN] / trains[GAIN]).mean(axis=0)
    return mean * plant.setup.wheel_radius / drive.radius, mean


def held(estimate: Estimate | None, truth: Truth) -> Row:
    """Return, for each quantity, how many 95 % intervals there are and how many hold the truth, and
    the sum of the squared errors over the squared standard deviations."""
    row: Row = {}
    names = {field.name for field in fields(Estimate)} if estimate else set[str]()
    for name in QUANTITIES:
        value, std = (
            np.array(getattr(estimate, name_of_part, None), float)
            for name_of_part in (name, f"{name}_std")
        )
        if name not in names or np.isnan(value).any():
            row |= {f"{name}_of": 0, f"{name}_held": 0, f"{name}_squares": 0.0}
            continue
        lives = truth["lives"] if value.ndim else np.True_
        off = (value - truth[name])[lives]
        std = std[lives]
        inside = int((np.abs(off) <= 1.96 * std).sum())  # what is known for sure has no deviation
        is_unsure = std > 0
        squares = float(((off[is_unsure] / std[is_unsure]) ** 2).sum())
        row |= {f"{name}_of": off.size, f"{name}_held": inside, f"{name}_squares": squares}
    return row


def read(path: Path) -> list[Row]:
    """Return the rows of a CSV, [] if there is none."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = csv.DictReader(file)
        return [_with_numbers(row) for row in rows]


def _with_numbers(row: dict[str, str]) -> Row:
    return {name: text if name == TOLD else float(text) for name, text in row.items()}


HEAD = (
    "world",
    "n",
    "total error, mean and 95 % interval",
    "median / worst; worst robot",
    "above 100 / not completed",
    "trial [s], mean / longest",
    "bodies over an edge / in an obstacle / touching (worst [mm])",
    "misfit said",
    *(f"{name} held" for name in QUANTITIES.values()),
    "missed: said",
    "steps over the period / longest [ms]",
)


def line(name: str, rows: list[Row]) -> str:
    """Return a world's line of the table."""
    columns = {}
    for key in rows[0]:
        if key != TOLD:
            columns[key] = np.array([row[key] for row in rows])
    (error,) = distributions(columns["error"][None])
    gaps = [columns[f"{what}_mm"] for what in ("edge", "obstacle", "apart")]
    quiet = columns["misfit"] == 0
    missed = np.zeros(len(rows), dtype=np.bool_)
    shares = []
    for what in QUANTITIES:
        inside = columns[f"{what}_held"]
        reference = columns[f"{what}_of"]
        missed |= inside < reference
        squares = columns[f"{what}_squares"][quiet].sum()
        number = reference[quiet].sum()
        rms = np.sqrt(squares / max(number, 1))
        shares.append(f"{inside[quiet].sum():.0f} of {number:.0f}; {rms:.2f}")
    said = columns["misfit"] > 0
    negative = [f"{(gap < 0).sum()}" for gap in gaps]
    cells = (
        f"`{name}`",
        f"{len(rows)}",
        f"{error.mean:.1f} [{error.ci95.low:.1f}, {error.ci95.high:.1f}]",
        f"{np.median(columns['error']):.1f} / {columns['error'].max():.1f}; "
        f"{columns['greatest'].max():.1f}",
        f"{(columns['error'] > FAR_MM).sum()} / {(columns['complete'] == 0).sum()}",
        f"{columns['seconds'].mean():.1f} / {columns['seconds'].max():.1f}",
        f"{' / '.join(negative)} ({max(0.0, -np.min(gaps)):.1f})",
        f"{said.sum()}",
        *shares,
        f"{missed.sum()}: {(missed & said).sum()}",
        f"{columns['late_steps'].sum():.0f} / {columns['step_max_ms'].max():.0f}",
    )
    return f"| {' | '.join(cells)} |"


def compare(rows_of: dict[str, list[Row]], folder: Path) -> None:
    """Print differences from another version's trials, with Holm's intervals: at 1 - 0.05 / k for
    the difference of least p of k, at 1 - 0.05 / (k - 1) for the next, and so on."""
    pairs: dict[tuple[str, str], np.ndarray] = {}
    for name, rows in rows_of.items():
        others = {(row["seed"], row["trial"]): row for row in read(folder / f"{name}.csv")}
        paired = [(row, others.get((row["seed"], row["trial"]))) for row in rows]
        for what in ("error", "seconds"):
            pairs[name, what] = np.array([(a[what], b[what]) for a, b in paired if b]).reshape(
                -1, 2
            )
    tested = {key: paired_t(two[:, 0] - two[:, 1]) for key, two in pairs.items() if len(two) > 1}
    order = sorted(
        (test.p_value, key) for key, test in tested.items() if test.p_value == test.p_value
    )
    levels = {key: 0.05 / (len(order) - i) for i, (_, key) in enumerate(order)}
    print("\n| world | | pairs, equal | before | now | now - before, Holm's 95 % interval | |")
    print("|---|---|---|---|---|---|---|")
    for key, test in tested.items():
        more = np.subtract(*pairs[key].T)
        now, before = pairs[key].mean(axis=0)
        half = 0.0
        verdict = "equal"
        if key in levels:
            reach = stats.t.ppf(1 - levels[key] / 2, len(more) - 1)
            half = reach * more.std(ddof=1) / np.sqrt(len(more))
            verdict = ""
            if test.value > half:
                verdict = "**worse**"
            elif test.value < -half:
                verdict = "better"
        cells = f"{before:.1f} | {now:.1f} | {test.value:.2f} [{test.value - half:.2f}, "
        cells += f"{test.value + half:.2f}], {100 * test.value / before:+.0f} % | {verdict}"
        print(f"| `{key[0]}` | {key[1]} | {len(more)}, {(more == 0).sum()} | {cells} |")


def main() -> None:
    names = [f"{name}{rate}" for name in WORLDS for rate in ("", "-5hz")]
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--world", nargs="+", choices=names, metavar="WORLD", default=[*WORLDS])
    parser.add_argument("--trials", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--seed", type=int, default=20261124)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], help="a setting of every spec")
    parser.add_argument("--out", type=Path, help="folder of a CSV for each world")
    parser.add_argument("--against", type=Path, help="such a folder of another version")
    options = parser.parse_args()
    print(f"Simulated, seed {options.seed}. {load()}.\n")
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    numbers = range(options.first, options.first + options.trials)
    rows_of = dict[str, list[Row]]()
    with get_context("spawn").Pool(options.jobs) as pool:
        for name in options.world:
            progress(name)
            tasks = [(name, trial) for trial in numbers]
            rows = list(pool.imap(partial(run, options.seed, options.set), tasks, chunksize=1))
            if options.out:
                done = {(row["seed"], row["trial"]) for row in rows}
                earlier = [
                    row for row in read(options.out / f"{name}.csv") if row["seed"] == options.seed
                ]
                rows += [row for row in earlier if (row["seed"], row["trial"]) not in done]
            if not rows:
                continue
            rows_of[name] = sorted(rows, key=lambda row: row["trial"])
            print(line(name, rows_of[name]), flush=True)
            if options.out:
                options.out.mkdir(parents=True, exist_ok=True)
                with (options.out / f"{name}.csv").open("w", newline="") as file:
                    writer = csv.DictWriter(file, list(rows[0]))
                    writer.writeheader()
                    writer.writerows(rows_of[name])
    if options.against:
        compare(rows_of, options.against)


if __name__ == "__main__":
    main()
