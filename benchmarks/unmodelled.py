"""Measure the closed loop under disturbances that the motion model (1)-(3) leaves out.

    python benchmarks/unmodelled.py --trials 50                         every row, robots at 20 Hz
    python benchmarks/unmodelled.py --rows base sides --rate 5 --trials 20

Robots are those of three_m3pi.yaml in the world of disturbed.py, part `hurting`; all rows except
`base` add a disturbance of this file. Cells are those of tetrahymena_bench.yaml (`axis`); in the
other rows the camera shows their bodies, a is up to 50 % off, and they start at any heading. All
rows have the same seeds. Everything is simulated. The last columns are about the last estimates.
"""

import argparse
import json
from dataclasses import replace
from typing import Literal

import numpy as np
from disturbed import HURT, RATES, as_specified
from disturbed import run as run_trials
from solverbench.problems import OURS, experiment
from solverbench.report import load, progress

from tetractl.control.mpc import Mpc
from tetractl.core.plan import Estimate
from tetractl.core.poses import Poses, wrap
from tetractl.core.protocols import Controller, Plant
from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import DelayedCommand, Disturbance, DisturbanceSection
from tetractl.experiment.experiment import Experiment
from tetractl.results.estimate import distributions

CELLS = "tetrahymena_bench.yaml"
LATE_S = 0.12  # further dead time of the last robot to hear a command
SIDES = 0.2  # a to one side is 1 + SIDES of the spec's, to the other 1 - SIDES
SLIDE_MM_S, DRAWN_RAD_S = 12.0, 0.1  # slide, and turning rate towards its direction
Random = np.random.Generator


class Late(Disturbance):
    """Each robot hears commands later, by a time of its own."""

    def __init__(self, count: int, random: Random) -> None:
        late = random.permutation(np.linspace(0, LATE_S, count))
        self.late_ns = (1e9 * late).astype(np.int64)

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        before = 0 if command.late_ns is None else command.late_ns
        return replace(command, late_ns=before + self.late_ns)


class Sides(Disturbance):
    """Each robot turns faster to one side than to the other."""

    def __init__(self, count: int, random: Random) -> None:
        self.more, self.before = SIDES * random.choice([-1.0, 1.0], count), None

    def moved(self, poses: Poses, moving: np.ndarray, seconds: float, time_s: float) -> Poses:
        heading = poses.heading
        if self.before is not None:
            heading = heading + self.more * np.abs(wrap(heading - self.before)) * moving
        self.before = heading
        return Poses(poses.x, poses.y, heading)


class Slide(Disturbance):
    """Moving robots slide downhill, and their headings are drawn there."""

    def __init__(self, count: int, random: Random) -> None:
        self.down = random.uniform(-np.pi, np.pi)

    def moved(self, poses: Poses, moving: np.ndarray, seconds: float, time_s: float) -> Poses:
        way, drawn = SLIDE_MM_S * seconds * moving, DRAWN_RAD_S * seconds * moving
        x, y = poses.x + way * np.cos(self.down), poses.y + way * np.sin(self.down)
        return Poses(x, y, poses.heading + drawn * np.sin(self.down - poses.heading))


class Unmodelled(DisturbanceSection):
    """One of these disturbances."""

    type: Literal["late", "sides", "slide"]

    def build(self, setup: Setup, rng: Random) -> Disturbance:
        return {"late": Late, "sides": Sides, "slide": Slide}[self.type](len(setup.names), rng)


ROBOTS = ("base", "late", "sides", "slide")
BODIES = {"body": (8, 1.5), "fast": (8, 2.5), "no-helix": (0, 1)}
"""Radius [um] and frequency [Hz] of the helix of cells whose bodies the camera shows."""
HEAD = (
    "| row | total error [mm or um], mean and 95 % interval | median / worst "
    "| above 20 / 30 / 100 [%] | trial [s] | a, speed within 2 sigma | a off, claimed, rms [%] "
    "| dead time, its sigma [ms] | step p50 [ms] |"
)
ROWS = (*ROBOTS, "axis", *BODIES)


def spec_of(name: str, rate: int, *settings: str) -> Experiment:
    if name in ROBOTS:
        spec = experiment(OURS, *HURT, *RATES[rate], *settings)
        more = () if name == "base" else (Unmodelled(type=name),)
        plant = spec.plant.model_copy(update={"disturbances": more})
        return spec.model_copy(update={"plant": plant})
    spec = experiment(CELLS, *settings)
    if name == "axis":
        return spec
    given = [one.model_dump(mode="json") for one in spec.plant.disturbances]
    radius, frequency = BODIES[name]
    given[-1]["heading"] = 3.1416
    given.append({"type": "wobble", "radius": radius, "frequency": frequency})
    told = f"plant.disturbances={json.dumps(given)}"
    return experiment(CELLS, *settings, "plant.cells=null", "plant.a_error=0.5", told)


def report(name: str, spec: Experiment, trials: int) -> None:
    """Run the trials of a row and print it."""
    made: list[tuple[Mpc, Plant]] = []

    def build(spec: Experiment, key: int, plant: Plant) -> Controller:
        checked = as_specified(spec, key, plant)
        made.append((checked.controller, plant))
        return checked

    results = run_trials(spec, trials, build)
    ends: list[tuple[Estimate, Plant]] = [(mpc.estimator.estimate, plant) for mpc, plant in made]
    off = np.concatenate([np.log(one.a / plant.a) for one, plant in ends])
    claimed = np.concatenate([one.a_std / one.a for one, _ in ends])
    fast = np.concatenate([(one.speed - plant.speed) / one.speed_std for one, plant in ends])
    errors = np.array([one.total_error for one in results])
    (described,) = distributions(errors[None], 30.0)
    low, high = described.ci95.low, described.ci95.high
    above = " / ".join(f"{100 * np.mean(errors > bound):.0f}" for bound in (20, 30, 100))
    dead = np.mean([(one.dead_time, one.dead_time_std) for one, _ in ends], axis=0)
    held = np.abs(off) <= 2 * claimed
    cells = (
        name,
        f"{errors.mean():.1f} [{low:.1f}, {high:.1f}]",
        f"{np.median(errors):.1f} / {errors.max():.0f}",
        above,
        f"{np.mean([one.duration_s for one in results]):.1f}",
        f"{held.sum()} of {held.size}, {np.sum(np.abs(fast) <= 2)}",
        f"{100 * np.sqrt(np.mean(off**2)):.1f} / {100 * np.sqrt(np.mean(claimed**2)):.1f}",
        " ".join(f"{1e3 * one:.1f}" for one in dead),
        f"{np.median(np.concatenate([one.solve_ns[1:] for one in results])) / 1e6:.1f}",
    )
    print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=(*ROBOTS, "axis", "body"))
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--rate", type=int, choices=tuple(RATES), default=20, help="robots' [Hz]")
    parser.add_argument("--set", action="append", default=[], help="a setting of every spec")
    chosen = parser.parse_args()
    print(f"Simulated, {chosen.trials} trials a row. {load()}.\n")
    print(HEAD + "\n" + "|---" * (HEAD.count("|") - 1) + "|")
    for name in chosen.rows:
        progress(name)
        report(name, spec_of(name, chosen.rate, *chosen.set), chosen.trials)


if __name__ == "__main__":
    main()
