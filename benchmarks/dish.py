"""Cells that a trial finds in the emulated dish: steered through pictures, and surveyed.

    python benchmarks/dish.py trials    three cells through pictures, and the same cells simulated
    python benchmarks/dish.py survey    predicted error of the cells chosen, over the best choice's

Everything is emulated, in virtual time; pictures are synthetic. Seeds from 9000 on are those of the
published figures; smaller ones were used in development.
"""

import argparse
import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.virtual_dish import DISH, VirtualDish, virtual_dish

from tetractl.analysis.choices import ranked
from tetractl.analysis.closed_loop import Noise
from tetractl.core.errors import TetractlError
from tetractl.core.protocols import LabSupervision
from tetractl.core.trial import Start, Step
from tetractl.experiment.choice import FoundCell
from tetractl.experiment.choosing import of_robots
from tetractl.experiment.load import load_spec
from tetractl.lab.find_cells import turn_field
from tetractl.lab.rig import build_rig
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import run_with

FIRST_SEED = 9000
PLANS = 2


class Witness:
    """Which true cell each robot is at each control step, by its place; an observer."""

    def __init__(self, dish: VirtualDish) -> None:
        self.dish, self.who = dish, []

    def on_start(self, start: Start) -> None:
        self.setup = start.setup

    def on_step(self, step: Step) -> None:
        cells, poses = self.dish.cells, step.observation.poses
        gaps = np.hypot(poses.x[:, None] - cells.x, poses.y[:, None] - cells.y)
        self.who.append(tuple(gaps.argmin(axis=1).tolist()))

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *args: None


def trials(count: int) -> None:
    """A trial counts as swapped where a robot is another cell at its end than at its beginning."""
    seen, simulated, swapped, failed = [], [], 0, []
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        interrupt = Interrupt(lambda number: None)
        with tempfile.TemporaryDirectory() as folder, virtual_dish(folder, seed) as dish:
            witness = Witness(dish)
            try:
                result = run_with([witness], dish.spec, 0, [], interrupt)
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
        seen.append(result.total_error)
        simulated.append(run_with([], same, 0, [], interrupt).total_error)
        print(
            f"seed {seed}: {seen[-1]:.0f} um through pictures, {simulated[-1]:.0f} simulated; "
            f"{swapped} swapped so far",
            flush=True,
        )
    print(
        f"{count} emulated trials of 3 cells: {len(seen)} ended, {swapped} with swapped identities"
    )
    for reason in failed:
        print(f"did not end: {reason}")
    ratio = np.mean(seen) / np.mean(simulated)
    print(
        f"mean total error {np.mean(seen):.1f} um through pictures, {np.mean(simulated):.1f} "
        f"simulated with the same cells: {ratio:.2f} times; medians {np.median(seen):.1f} and "
        f"{np.median(simulated):.1f}"
    )


def survey(count: int) -> None:
    """Choices are compared from where the cells are when the survey ends."""
    ratios = []
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        noise = Noise.of(load_spec(DISH).experiment.plant)
        with tempfile.TemporaryDirectory() as folder, virtual_dish(folder, seed) as dish:
            experiment = dish.spec.experiment
            rig = build_rig(experiment.plant, experiment.setup, dish.clock)
            with rig:
                cells = turn_field(rig, experiment.chosen, seed, LabSupervision())
            known = [true_cell(cell, dish) for cell in cells]
        ours = ranked(experiment, cells, noise, PLANS)
        truth = {numbers(one.cells): one.error for one in ranked(experiment, known, noise, PLANS)}
        best = min(truth.values(), default=math.inf)
        ours_true = truth.get(numbers(ours[0].cells), math.inf) if ours else math.inf
        ratios.append(ours_true / best if math.isfinite(best) else 1.0)
        print(f"seed {seed}: {ours_true:.0f} um of {best:.0f}: {ratios[-1]:.2f}", flush=True)
    good = sum(ratio <= 1.2 for ratio in ratios)
    print(
        f"{count} emulated dishes: predicted error of the chosen cells over the best, median "
        f"{np.median(ratios):.2f}; at most 1.2 in {good}"
    )


def true_cell(cell: FoundCell, dish: VirtualDish) -> FoundCell:
    """The cell with the a and speed that it truly has."""
    cells = dish.cells
    i = int(np.hypot(cells.x - cell.pose.x, cells.y - cell.pose.y).argmin())
    return replace(cell, a=float(cells.a[i]) or cell.a, speed=float(cells.speed[i]))


def numbers(cells: tuple[FoundCell, ...]) -> frozenset[int]:
    return frozenset(cell.number for cell in cells)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("part", choices=("trials", "survey"))
    parser.add_argument("--count", type=int, default=20)
    chosen = parser.parse_args()
    {"trials": trials, "survey": survey}[chosen.part](chosen.count)
