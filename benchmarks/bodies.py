"""Count the trials in which a robot's body touches an edge, an obstacle or another robot.

    python benchmarks/bodies.py --trials 1000 --jobs 2             at 5 and at 20 Hz
    python benchmarks/bodies.py --rate 5 --out new.csv             a row for each trial
    python benchmarks/bodies.py --rate 5 --against old.csv         against another version

The plant is that of `disturbed.py --part hurting`, first row. A body is a disc of the spec's
`controller.collision.radius`, and the plant's own samples of the true path (960 Hz) decide whether
it touches anything. Each control step in which a body comes nearer than it was is traced: where the
controller expected the robot to be when its direction would act and to go until the next one, and
how far the robot went astray in that step (lost commands, heading walk, errors of a, speed and
pose). The disturbance of the step explains the touch unless the controller expected it.
"""

import argparse
import csv
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from disturbed import HURT, RATES
from solverbench.problems import OURS
from solverbench.problems import experiment as load_experiment
from solverbench.report import load

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import PlantInfo, Sample
from tetractl.core.poses import Floats
from tetractl.core.protocols import LabSupervision
from tetractl.core.trial import EPOCH_NS, Result, Step
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.loaded_spec import LoadedSpec, start_of
from tetractl.model.motion.exact import step as exact
from tetractl.model.obstacles import Obstacles
from tetractl.results.estimate import percent, proportion_interval
from tetractl.results.mean_difference import paired_t
from tetractl.run.checked_controller import build_controller
from tetractl.run.control_loop import Trial
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import trial_seeds

SURE_MM = 1.0  # by which a path may be expected to come nearer, for rounding and camera noise
LARGE_MM = 20.0
MOMENTS = np.linspace(0, 1, 41)  # of a control step, at which the expected path is examined


class Kept:
    """An observer that keeps control steps and true poses."""

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.samples: list[Sample] = []

    def on_step(self, step: Step) -> None:
        self.steps.append(step)

    def on_samples(self, samples: list[Sample]) -> None:
        self.samples += samples

    def __getattr__(self, name: str):  # on_start, on_command, on_note, on_stop
        return lambda *_: None


@dataclass(frozen=True)
class Row:
    """What came out of one trial; `traced` has a line for each step in which a body touched."""

    trial: int
    error: float
    seconds: float
    outcome: str
    edge: float
    obstacle: float
    apart: float
    unexplained: int
    traced: tuple[str, ...] = ()


def run(spec: Experiment, trial: int) -> Row:
    """Run one trial in virtual time."""
    key, seed = trial_seeds(spec.trials.seed, trial)
    clock = VirtualClock()
    nowhere = PlantInfo("", True, 0.0, {})
    samples_of_trial = Kept()
    result = Trial(
        start=start_of(LoadedSpec(spec, "", ""), trial, nowhere, EPOCH_NS),
        plant=spec.plant.build(spec.setup, clock, seed, LabSupervision()),
        controller=build_controller(spec, key),
        clock=clock,
        observers=[samples_of_trial],
        interrupt=Interrupt(),
    ).run()
    verdict = result.verdict
    radius = spec.controller.collision.radius
    least = min(verdict.edge), min(verdict.clearance), min(verdict.apart)
    touched = min(least[0], least[1], least[2] - radius) < radius
    traced = list(trace(spec, trial, samples_of_trial)) if touched else []
    return Row(
        trial,
        result.total_error,
        result.duration_s,
        _outcome(result),
        *least,
        sum(unexplained for unexplained, _ in traced),
        tuple(text for _, text in traced),
    )


def _outcome(result: Result) -> str:
    return result.outcome.value + (f": {result.reason}" if result.reason else "")


def trace(spec: Experiment, trial: int, samples_of_trial: Kept) -> Iterator[tuple[bool, str]]:
    """Yield, for each control step in which a body touches something more than before, whether the
    controller expected that, and a line of a table."""
    setup = spec.setup
    names = spec.setup.names
    radius = spec.controller.collision.radius
    delay = round(spec.plant.dead_time * SECOND)
    sampled_ns = np.array([sample.observation.sampled_ns for sample in samples_of_trial.samples])
    path = np.array([sample.truth.array() for sample in samples_of_trial.samples])
    region = Obstacles.of(setup.obstacles, 0.0, setup.arena)
    pairs = np.triu_indices(len(names), 1)

    def room(x: Floats, y: Floats) -> Floats:
        """Distances between bodies (..., N + pairs): to obstacles and edges, and between two."""
        first_of_pair, second_of_pair = pairs
        gaps = np.hypot(
            x[..., first_of_pair] - x[..., second_of_pair],
            y[..., first_of_pair] - y[..., second_of_pair],
        )
        return np.concatenate([region.distance(x, y) - radius, gaps - 2 * radius], axis=-1)

    who = [*names, *(f"{names[i]}-{names[j]}" for i, j in zip(*pairs, strict=True))]
    for step, after in zip(
        samples_of_trial.steps, [*samples_of_trial.steps[1:], None], strict=True
    ):
        begin = step.command.sent_ns + delay
        end = sampled_ns[-1] if after is None else after.command.sent_ns + delay
        inside = np.flatnonzero((sampled_ns >= begin) & (sampled_ns <= end))
        if not len(inside):
            continue
        true = room(path[inside, :, 0], path[inside, :, 1])
        plan = step.plan
        estimate = step.plan.estimate
        x, y, heading = plan.path[0].T
        drives = not plan.pauses
        period = spec.controller.period * MOMENTS[:, None] * drives
        u = (plan.signals[0] if drives else 0.0) + (estimate.heading_bias if estimate else 0.0)
        a, speed = (estimate.a, estimate.speed) if estimate else (setup.a, setup.speed)
        ahead = exact(x, y, heading, u, a, speed, period)
        planned = room(ahead[0], ahead[1])
        for i, name in enumerate(who):
            now = true[0, i]
            least = true[:, i].min()
            expected = planned[:, i].min()
            if least >= min(0.0, now) - 1e-3:
                continue
            knew = bool(expected < min(0.0, planned[0, i]) - SURE_MM)
            off = np.hypot(*(path[inside[0], :, :2] - plan.path[0][:, :2]).T)
            involved = (
                [i] if i < len(names) else [pairs[0][i - len(names)], pairs[1][i - len(names)]]
            )
            lost = [names[j] for j in involved if not step.command.delivered[j]]
            cells = (
                trial,
                step.k,
                name,
                "rest" if plan.pauses else "drive",
                *(f"{value:.1f}" for value in (now, planned[0, i], expected, least)),
                ", ".join(lost) or "-",
                f"{off[involved].max():.1f}",
                "**expected**" if knew else "disturbance",
            )
            yield knew, f"| {' | '.join(map(str, cells))} |"


HEAD = (
    "trial",
    "step",
    "body",
    "command",
    "room at its start",
    "room expected there",
    "least room expected",
    "least room",
    "command lost by",
    "position error at its start",
    "why",
)


def report(rate: int, rows: list[Row], radius: float, earlier: dict[int, float]) -> None:
    """Print what a rate's trials show, as Markdown."""
    n = len(rows)
    errors = np.array([row.error for row in rows])
    counts = {
        "body over an edge": sum(row.edge < radius for row in rows),
        "body in an obstacle": sum(row.obstacle < radius for row in rows),
        "two bodies touch": sum(row.apart < 2 * radius for row in rows),
        "any of these as the controller expected": sum(row.unexplained > 0 for row in rows),
        f"total error above {LARGE_MM:g} mm": int((errors > LARGE_MM).sum()),
    }
    print(f"\n**{rate} Hz**, {n} trials.\n\n| trials in which | number | 95 % interval |")
    print("|---|--:|---|")
    for name, count in counts.items():
        interval = percent(proportion_interval(count, n)).strip(" ()")
        print(f"| {name} | {count} | {interval} |")
    std = errors.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
    print(f"\nTotal error {errors.mean():.2f} mm (standard error {std:.2f}), ", end="")
    print(f"median {np.median(errors):.2f}, worst {errors.max():.1f}; ", end="")
    print(f"a trial takes {np.mean([row.seconds for row in rows]):.1f} s.", end=" ")
    numbers = Counter(row.outcome for row in rows)
    outcomes = [f"{name} {numbers[name]}" for name in sorted(numbers)]
    print(f"Outcomes: {', '.join(outcomes)}.")
    paired_rows = [row for row in rows if row.trial in earlier]
    if paired_rows:
        before = np.array([earlier[row.trial] for row in paired_rows])
        more = np.array([row.error for row in paired_rows]) - before
        difference = paired_t(more)
        low = difference.ci95.low
        high = difference.ci95.high
        print(
            f"\nMinus the other version, {len(paired_rows)} pairs, "
            f"{(more == 0).sum()} of them equal: "
        )
        print(f"{difference.value:.2f} mm [{low:.2f}, {high:.2f}]; there ", end="")
        print(f"{(before > LARGE_MM).sum()} were above {LARGE_MM:g} mm.")
    lines = [line for row in rows for line in row.traced]
    if lines:
        print(f"\n| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
        print("\n".join(lines))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--seed", type=int, default=20261122)
    parser.add_argument("--rate", type=int, choices=tuple(RATES), help="of the control [Hz]")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, help="CSV of the trials; needs --rate")
    parser.add_argument("--against", type=Path, help="such a CSV of another version")
    options = parser.parse_args()
    print(f"Simulated, seed {options.seed}, {', '.join(f'`{name}`' for name in HURT)}. {load()}.")
    earlier = {}
    if options.against:
        with options.against.open() as file:
            earlier = {int(row["trial"]): float(row["error"]) for row in csv.DictReader(file)}
    for rate in [options.rate] if options.rate else RATES:
        spec = load_experiment(OURS, *HURT, *RATES[rate], f"trials.seed={options.seed}")
        numbers = range(options.first, options.first + options.trials)
        with get_context("spawn").Pool(options.jobs) as pool:
            rows = list(pool.imap(partial(run, spec), numbers))
        report(rate, rows, spec.controller.collision.radius, earlier)
        if options.out:
            with options.out.open("w", newline="") as file:
                fields = ("trial", "error", "seconds", "outcome", "edge", "obstacle", "apart")
                writer = csv.writer(file)
                writer.writerow(fields)
                for row in rows:
                    writer.writerow([getattr(row, name) for name in fields])


if __name__ == "__main__":
    main()
