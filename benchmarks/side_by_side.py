"""How many control periods a second of one core simulated plants advance, side by side and alone.

    python benchmarks/side_by_side.py [--spec SPEC] [--set PATH=VALUE] [--trials B] [--rounds N]

Robots are steered in a new random direction every 8 periods, by no controller. Time is processor
time, the least of the rounds. Prints Markdown.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.experiment.load import load_spec
from tetractl.plant.sim_plants import SimPlants
from tetractl.plant.simulation import SimPlant, SimSection

ROOT = Path(__file__).parents[1]
STEPS, ALONE = 80, 8  # control periods of a trial, and trials that run one by one


def side_by_side(section: SimSection, setup: Setup, directions: Floats) -> float:
    """Return the processor time [s] of trials under `directions` (steps, trials)."""
    seeds = [np.random.SeedSequence(1, spawn_key=(b,)) for b in range(directions.shape[1])]
    plants = SimPlants(section, setup, seeds)
    began = time.process_time()
    for each in directions:
        plants.step(each)
    return time.process_time() - began


def alone(section: SimSection, setup: Setup, directions: Floats) -> float:
    """Return the same for trials one by one."""
    used = 0.0
    for b, column in enumerate(directions.T.tolist()):
        plant = SimPlant(section, setup, VirtualClock(), np.random.SeedSequence(1, spawn_key=(b,)))
        began = time.process_time()
        plant.open()
        for k, direction in enumerate(column):
            plant.send(Steer(direction))
            plant.clock.sleep_until(round((k + 1) * setup.period_s * SECOND))
            plant.observe()
        used += time.process_time() - began
    return used


def main() -> None:
    """Print a row for each way."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    default = ROOT / "experiments" / "three_m3pi_bench.yaml"
    parser.add_argument("--spec", type=Path, default=default)
    parser.add_argument("--set", dest="sets", action="append", default=[], metavar="PATH=VALUE")
    parser.add_argument("--trials", type=int, default=256, metavar="B")
    parser.add_argument("--rounds", type=int, default=5, metavar="N")
    asked = parser.parse_args()
    spec = load_spec(asked.spec, asked.sets).experiment
    assert isinstance(spec.plant, SimSection)
    quiet = spec.plant.model_copy(update={"disturbances": ()})
    print(f"{asked.spec.name}, {1 / spec.setup.period_s:.3g} Hz, {STEPS} periods a trial\n")
    print("| | trials | periods a second | us a period |")
    print("|---|--:|--:|--:|")
    for name, run, section, trials in (
        ("one by one", alone, spec.plant, ALONE),
        ("one by one, without `disturbances`", alone, quiet, ALONE),
        ("side by side", side_by_side, spec.plant, asked.trials),
        ("side by side, without `disturbances`", side_by_side, quiet, asked.trials),
    ):
        drawn = np.random.default_rng(1).uniform(-np.pi, np.pi, (STEPS // 8, trials))
        directions = np.repeat(drawn, 8, axis=0)
        try:
            used = min(run(section, spec.setup, directions) for _ in range(asked.rounds + 1))
        except UsageError as error:
            print(f"| {name} | {trials} | {error} | |")
            continue
        rate = directions.size / used
        print(f"| {name} | {trials} | {rate:.0f} | {1e6 / rate:.1f} |")


if __name__ == "__main__":
    main()
