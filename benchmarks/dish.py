"""Three cells that a trial finds in the emulated dish, steered through pictures and simulated.

    python benchmarks/dish.py --count 20

prints the figures of "Distinguished and steered" in cells-explained.md. Everything is emulated, in
virtual time; pictures are synthetic. Seeds from 9000 on are those of the published figures; smaller
ones were used in development.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.extend(map(str, Path(__file__).parents[1].glob("packages/*/tests")))
from support.virtual_lab import DISH, VirtualLab, virtual_dish
from tetractl_microscope.choice.section import choice_of

from tetractl.core.errors import TetractlError
from tetractl.core.setup import Setup
from tetractl.core.trial import Start, Step
from tetractl.experiment.experiment import Experiment, Robot
from tetractl.experiment.load import load_spec
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import ready_trial

FIRST_SEED = 9000


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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=20)
    trials(parser.parse_args().count)
