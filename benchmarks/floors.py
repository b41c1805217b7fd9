"""Measure how far the controller is from its floor, at equal time, in each disturbed world.

    python benchmarks/floors.py --trials 40 --seed 60201

The floor is the same controller with perfect knowledge of poses, a, speed, dead time and lost
commands at each control step. Both drive on until the error is accepted, so a smaller accepted
error costs time: a floor is a curve of error against time, and only errors at equal time compare.
The last column is the floor's least error up to the controller's time, by straight lines between
its points; beyond them it is that of the nearest point, in brackets. A floor is no bound: it ends
its trials by the same rules. Rows are the bench and those of
disturbed.py, part `hurting`, all with the same seeds. Everything is simulated.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from disturbed import (
    HURT,
    HURTING,
    OURS,
    Build,
    Knowing,
    World,
    as_specified,
    counted,
    load,
    progress,
    run,
)

from tetractl.core.commands import Command
from tetractl.core.plan import End, Outcome, Plan
from tetractl.core.poses import Observation
from tetractl.core.protocols import Controller, Plant
from tetractl.core.trial import Result
from tetractl.experiment.experiment import Experiment
from tetractl.plant.simulation import SimPlant
from tetractl.results.estimate import distributions

ACCEPTED_MM = (24, 12, 6, 3)
BENCH = "three_m3pi_bench.yaml"


class Seeing(Knowing):
    """A controller that knows the true poses, a and speed of a simulation at each control step."""

    plant: SimPlant

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        a, speed = self.plant.rates
        stands = speed == 0  # and will go on as before
        rates = {
            "a": np.where(stands, self.plant.a, a),
            "speed": np.where(stands, self.plant.speed, speed),
        }
        self.estimator.problem = replace(self.estimator.problem, **rates)
        for i, bank in enumerate(self.heard.banks):
            bank.model.parameters[:] = np.column_stack([rates["a"][i], rates["speed"][i]])
        now = self.plant.clock.now()
        all_valid = np.ones_like(observation.valid)
        true = {
            "poses": self.plant.poses,
            "valid": all_valid,
            "sampled_ns": now,
            "received_ns": now,
        }
        return super().plan(replace(observation, **true), last_command, earlier)


def seeing(dead_time_s: float, spec: Experiment, key: int, plant: Plant) -> Controller:
    """The same controller, which knows the dead time and what `Seeing` does."""
    assert isinstance(plant, SimPlant)
    settings = {"estimate": False, "dead_time": dead_time_s}
    section = spec.controller.model_copy(update=settings)
    controller = counted(Seeing, section, spec.setup, key)
    controller.plant = plant
    return controller


def curve(spec: Experiment, trials: int, build: Build) -> list[list[Result]]:
    """Run the trials with each accepted error."""
    results_of = []
    for accepted in ACCEPTED_MM:
        control = spec.controller.model_copy(update={"accept_error": float(accepted)})
        results_of.append(run(spec.model_copy(update={"controller": control}), trials, build))
    return results_of


def points(results: Sequence[Sequence[Result]]) -> np.ndarray:
    """Return mean time [s] and mean total error [mm] of each group of trials, (2, groups)."""
    means = []
    for group in results:
        values = [(result.duration_s, result.total_error) for result in group]
        means.append(np.mean(values, axis=0))
    return np.array(means).T


def at(time_s: float, floor: np.ndarray) -> str:
    """Return the least error of the floor up to a time, in brackets outside its curve."""
    times, errors = floor[:, np.argsort(floor[0])]
    text = f"{np.interp(time_s, times, np.minimum.accumulate(errors)):.1f}"
    return text if times[0] <= time_s <= times[-1] else f"({text})"


def rows(name: str, world: World, settings: Sequence[str], trials: int) -> None:
    """Print a world's lines of the table in Markdown, one for each accepted error."""
    controller_of = partial(seeing, world.dead_time_s)
    spec = world.spec(OURS, settings)
    ours, floor = (curve(spec, trials, build) for build in (as_specified, controller_of))
    reached = points(floor)
    for accepted, mine, floor_mm, time_s in zip(
        ACCEPTED_MM, ours, floor, points(ours)[0], strict=True
    ):
        cells = [name, f"{accepted}"]
        for group in (mine, floor_mm):
            errors_and_times = np.array(
                [(result.total_error, result.duration_s) for result in group]
            )
            (error, time) = distributions(errors_and_times.T)
            low = error.ci95.low
            high = error.ci95.high
            cells += [f"{error.mean:.1f} [{low:.1f}, {high:.1f}]", f"{time.mean:.1f}"]
        print(f"| {' | '.join([*cells, at(time_s, reached)])} |", flush=True)
        name = ""


HEAD = (
    "world",
    "accepted [mm]",
    "controller: error [mm]",
    "time [s]",
    "floor: error [mm]",
    "time [s]",
    "floor at the controller's time [mm]",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=60201, help="root seed")
    parser.add_argument("--rows", type=int, nargs="*", help="of the table, from 0; all by default")
    chosen = parser.parse_args()
    seed = f"trials.seed={chosen.seed}"
    world = World(None, 20, 0.11, (*HURT, seed))
    bench = World(BENCH, 20, 0.06, (seed,))
    worlds = [(BENCH, bench, ()), *((name, world, settings) for name, settings in HURTING)]
    print(f"Simulated, {chosen.trials} trials a cell, 20 Hz, `{seed}`. {load()}.\n")
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    for i in range(len(worlds)) if chosen.rows is None else chosen.rows:
        progress(worlds[i][0])
        rows(*worlds[i], chosen.trials)


if __name__ == "__main__":
    main()
