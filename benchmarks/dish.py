"""Cells that a trial finds in the emulated dish: steered through pictures, and surveyed.

    python benchmarks/dish.py trials    three cells through pictures, and the same cells simulated
    python benchmarks/dish.py survey    predicted error of the cells chosen, over the best choice's

Everything is emulated, in virtual time; pictures are synthetic. Seeds from 9000 on are those of the
published figures; smaller ones were used in development.
"""

import argparse
import itertools
import math
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.extend(map(str, Path(__file__).parents[1].glob("packages/*/tests")))
from scipy.optimize import linear_sum_assignment
from support.virtual_lab import DISH, VirtualLab, virtual_dish
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.ranked import RankedChoice, ranked
from tetractl_microscope.choice.section import choice_of
from tetractl_microscope.choice.turn_field import turn_field

from tetractl.analysis.closed_loop import Noise
from tetractl.core.errors import TetractlError
from tetractl.core.protocols import LabSupervision
from tetractl.core.setup import Setup
from tetractl.core.trial import Start, Step
from tetractl.experiment.experiment import Experiment, Robot
from tetractl.experiment.load import load_spec
from tetractl.lab.rig import build_rig
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import ready_trial

FIRST_SEED = 9000
PLANS = 96
TESTED = 192  # plans


class Witness:
    """Which true cell each robot is at each control step, by its place; an observer."""

    def __init__(self, dish: VirtualLab) -> None:
        self.dish = dish
        self.who = []

    def on_start(self, start: Start) -> None:
        self.setup = start.setup

    def on_step(self, step: Step) -> None:
        cells = self.dish.cells
        poses = step.observation.poses
        gaps = np.hypot(poses.x[:, None] - cells.x, poses.y[:, None] - cells.y)
        nearest = gaps.argmin(axis=1)
        self.who.append(tuple(nearest.tolist()))

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *args: None


def of_robots(experiment: Experiment, setup: Setup) -> Experiment:
    """Return the experiment with the robots of `setup`, as found by one of its trials."""
    columns = (setup.starts.array(), setup.targets, setup.a, setup.speed)
    rows = zip(setup.names, *(column.tolist() for column in columns), strict=True)
    robots = tuple(
        Robot(name=name, start=(x, y), heading=turn, target=tuple(target), a=a, speed=speed)
        for name, (x, y, turn), target, a, speed in rows
    )
    chosen = experiment.chosen and choice_of(experiment).model_copy(update={"found": True})
    copied = experiment.model_copy(update={"robots": robots, "chosen": chosen})
    vars(copied).pop("setup", None)  # the cached setup is that of the placeholder robots
    return copied


def trials(count: int) -> None:
    """A trial counts as swapped where a robot is another cell at its end than at its beginning."""
    pictured = []
    simulated = []
    swapped = 0
    failed = []
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        interrupt = Interrupt(lambda number: None)
        with tempfile.TemporaryDirectory() as folder, virtual_dish(folder, seed) as dish:
            witness = Witness(dish)
            try:
                with ready_trial([witness], dish.spec, 0, [], interrupt) as trial:
                    result = trial.run()
            except TetractlError as error:
                failed.append(f"seed {seed}: {error}")
                continue
        if len(witness.who) > 0:
            swapped += witness.who[0] != witness.who[-1]
        if not result.outcome.complete:
            failed.append(f"seed {seed}: {result.reason or result.outcome}")
            continue
        loaded = load_spec(DISH, (f"trials.seed={seed}",))
        same = replace(loaded, experiment=of_robots(loaded.experiment, witness.setup))
        pictured.append(result.total_error)
        with ready_trial([], same, 0, [], interrupt) as trial:
            simulated.append(trial.run().total_error)
        print(
            f"seed {seed}: {pictured[-1]:.0f} um through pictures, {simulated[-1]:.0f} simulated; "
            f"{swapped} swapped so far",
            flush=True,
        )
    print(
        f"{count} emulated trials of 3 cells: {len(pictured)} ended, "
        f"{swapped} with swapped identities"
    )
    for reason in failed:
        print(f"did not end: {reason}")
    ratio = np.mean(pictured) / np.mean(simulated)
    print(
        f"mean total error {np.mean(pictured):.1f} um through pictures, {np.mean(simulated):.1f} "
        f"simulated with the same cells: {ratio:.2f} times; medians {np.median(pictured):.1f} and "
        f"{np.median(simulated):.1f}"
    )


def survey(count: int) -> None:
    """Choices are compared from where the cells are when the survey ends.

    Errors are predicted with the true a and speed along plans that no choice was made by; the best
    is the least among the first choices with the estimates and with perfect knowledge. That of
    perfect knowledge, by other random numbers, shows what ratio the number of plans allows.
    """
    noise = Noise.of(load_spec(DISH).experiment.plant)
    ratios = []
    floors = []
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        experiment, cells, true_of = surveyed(seed)
        with_truth = reseeded(experiment, seed + 10_000)
        choices = [
            ranked(experiment, cells, noise, PLANS),
            ranked(with_truth, list(true_of.values()), noise, PLANS),
        ]
        test = reseeded(experiment, seed + 20_000)
        errors = true_errors(itertools.chain(*choices), true_of, test, noise)
        best = min(errors.values(), default=math.inf)
        if not math.isfinite(best) or not all(choices):
            print(f"seed {seed}: no choice of {len(cells)} cells can be steered", flush=True)
            continue
        ours, floor = (errors[numbers(choice[0].cells)] for choice in choices)
        ratios.append(ours / best)
        floors.append(floor / best)
        print(
            f"seed {seed}: {ours:.0f} um of {best:.0f}: {ratios[-1]:.2f}; with perfect knowledge "
            f"and other random numbers {floors[-1]:.2f}",
            flush=True,
        )
    for name, ratios_of in (("chosen", ratios), ("with perfect knowledge", floors)):
        good = sum(ratio <= 1.2 for ratio in ratios_of)
        print(
            f"{len(ratios_of)} of {count} emulated dishes, predicted error of the cells {name} "
            f"over the best: median {np.median(ratios_of):.2f}, worst {max(ratios_of):.2f}, "
            f"at most 1.2: {good}"
        )


def surveyed(
    seed: int,
) -> tuple[Experiment, Sequence[RobotCandidate], dict[int, RobotCandidate]]:
    """Turn the field in an emulated dish; return its experiment, the cells that were found, and
    those cells with the numbers that they truly have."""
    with tempfile.TemporaryDirectory() as folder, virtual_dish(folder, seed) as dish:
        experiment = dish.spec.experiment
        rig = build_rig(experiment.plant, experiment.setup, dish.clock)
        with rig:
            cells = turn_field(rig, choice_of(experiment), seed, LabSupervision())
        return experiment, cells, true_cells(cells, dish)


def true_errors(
    choices: Iterable[RankedChoice],
    true_of: dict[int, RobotCandidate],
    test: Experiment,
    noise: Noise,
) -> dict[frozenset[int], float]:
    """The error predicted of each choice of cells with the a and speed that they truly have."""
    errors = {}
    for choice in choices:
        true = tuple(true_of[cell.number] for cell in choice.cells)
        if numbers(true) not in errors:
            errors[numbers(true)] = RankedChoice(test, true, noise).along(TESTED).error
    return errors


def reseeded(experiment: Experiment, seed: int) -> Experiment:
    """The experiment with another root seed."""
    trials = experiment.trials.model_copy(update={"seed": seed})
    return experiment.model_copy(update={"trials": trials})


def true_cells(tracked: Sequence[RobotCandidate], dish: VirtualLab) -> dict[int, RobotCandidate]:
    """The cells found, by number, with the a and speed that each truly has.

    Where two have met, places alone do not say which is which: then the speed does.
    """
    cells = dish.cells
    x, y, speed = np.array([(cell.pose.x, cell.pose.y, cell.speed) for cell in tracked]).T
    gaps = np.hypot(x[:, None] - cells.x, y[:, None] - cells.y)
    gaps += 100 * np.abs(np.log(np.maximum(speed, 1.0)[:, None] / cells.speed))
    return {
        tracked[i].number: replace(
            tracked[i], a=float(cells.a[j]) or tracked[i].a, speed=float(cells.speed[j])
        )
        for i, j in zip(*linear_sum_assignment(gaps), strict=True)
    }


def numbers(cells: tuple[RobotCandidate, ...]) -> frozenset[int]:
    return frozenset(cell.number for cell in cells)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("part", choices=("trials", "survey"))
    parser.add_argument("--count", type=int, default=20)
    chosen = parser.parse_args()
    {"trials": trials, "survey": survey}[chosen.part](chosen.count)
