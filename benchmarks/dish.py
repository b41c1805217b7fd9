"""Steers three cells that a trial finds in the emulated dish by means of images.

    python benchmarks/dish.py --count 20

The output is the figures of "Distinguished and steered" in cells-explained.md. Everything is
emulated, in virtual time, with synthetic images. The published figures use seeds from 9000. Smaller
seeds were used in development.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from testkit.emulator.virtual_lab import VirtualLab, virtual_dish

from tetractl.core.errors import TetractlError
from tetractl.core.trial import Step
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import ready_trial

FIRST_SEED = 9000


class Witness:
    """An observer that records which true cell each robot is at each control step."""

    def __init__(self, dish: VirtualLab) -> None:
        self.dish = dish
        self.who = []

    def on_step(self, step: Step) -> None:
        cells = self.dish.cells
        poses = step.observation.poses
        gaps = np.hypot(poses.x[:, None] - cells.x, poses.y[:, None] - cells.y)
        nearest = gaps.argmin(axis=1)
        self.who.append(tuple(nearest.tolist()))

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *args: None


def trials(count: int) -> None:
    """Run trials, and count those in which a robot is another cell at the end than at the
    beginning.
    """
    errors = []
    swapped = 0
    failed = []
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        interrupt = Interrupt(lambda number: None)
        with tempfile.TemporaryDirectory() as folder, virtual_dish(folder, seed) as dish:
            witness = Witness(dish)
            try:
                with ready_trial(dish.spec, 0, [witness], interrupt) as trial:
                    result = trial.run()
            except TetractlError as error:
                failed.append(f"seed {seed}: {error}")
                continue
        if len(witness.who) > 0:
            swapped += witness.who[0] != witness.who[-1]
        if not result.outcome.complete:
            failed.append(f"seed {seed}: {result.reason or result.outcome}")
            continue
        errors.append(result.total_error)
        print(f"seed {seed}: {errors[-1]:.0f} um, {swapped} swapped so far", flush=True)
    print(
        f"{count} emulated trials of 3 cells: {len(errors)} ended, {swapped} with swapped "
        f"identities; mean total error {np.mean(errors):.1f} um"
    )
    for reason in failed:
        print(f"did not end: {reason}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=20)
    trials(parser.parse_args().count)
