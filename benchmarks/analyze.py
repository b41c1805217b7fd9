"""Check what `tetractl analyze` predicts against closed-loop trials.

    python benchmarks/analyze.py                a dozen instances, 10 trials each
    python benchmarks/analyze.py --trials 30    more trials
    python benchmarks/analyze.py --benchmark    the instances of experiments/benchmark instead, by
                                                their own controllers, which do not go round

Each instance of the dozen is a spec of experiments/ with a noise, and at times other robots. One
controller drives in all of them: model predictive control by multistart with identification, which
steers points without margins and does not rest. Everything is simulated. The last line is the rank
correlation (Spearman) of the predicted mean total error with that of the trials, over the
instances, both in ways that the robots drive in a control period, so that millimetres and
micrometres can be compared.
"""

import argparse
from dataclasses import dataclass

import numpy as np
import scipy
from solverbench.problems import EXPERIMENTS, run
from solverbench.problems import experiment as load_experiment
from solverbench.report import progress

from tetractl.analysis.closed_loop import Noise
from tetractl.analysis.steering import planner, steering
from tetractl.experiment.experiment import Experiment
from tetractl.results.estimate import distributions

CONTROLLER = (
    "controller={type: mpc, period: 0.2, horizon_max: 60, time_limit: 30, estimate: true,"
    " collision: {walls: false, adaptive: false, stop_before_collision: false},"
    " optimizer: {type: multistart, rounds: 8}}"
)


def noise(a: float, walk: float, position: float, heading: float) -> str:
    """The setting of a plant; the speed errs as a does."""
    measured = f"measurement_noise: {{position: {position}, heading: {heading}}}"
    errors = f"a_error: {a}, speed_error: {a}, heading_noise: {walk}"
    return f"plant={{type: sim, {errors}, {measured}}}"


BENCH = noise(0.05, 0.03, 1, 0.01)
QUIET = noise(0.02, 0.01, 0.3, 0.003)
ROUGH = noise(0.1, 0.1, 3, 0.03)
CELLS = noise(0.1, 0.05, 5, 0.05)


@dataclass(frozen=True)
class Instance:
    name: str
    spec: str
    settings: tuple[str, ...]
    robots: int | None = None  # the first ones of the spec; None for all
    controller: tuple[str, ...] = (CONTROLLER,)

    def experiment(self) -> Experiment:
        data = load_experiment(self.spec, *self.controller, *self.settings).model_dump(mode="json")
        data["robots"] = tuple(data["robots"][: self.robots])
        data["obstacles"] = tuple(data["obstacles"])
        data["lab"] = None
        return Experiment.model_validate(data)


def with_a(*values: float) -> tuple[str, ...]:
    return tuple(f"robots.{i}.a={a}" for i, a in enumerate(values))


INSTANCES = (
    Instance("3 m3pi, quiet", "three_m3pi.yaml", (QUIET,)),
    Instance("3 m3pi", "three_m3pi.yaml", (BENCH,)),
    Instance("3 m3pi, rough", "three_m3pi.yaml", (ROUGH,)),
    Instance("3 m3pi, not identified", "three_m3pi.yaml", (BENCH, "controller.estimate=false")),
    Instance("2 m3pi", "three_m3pi.yaml", (BENCH,), robots=2),
    Instance("1 m3pi", "three_m3pi.yaml", (BENCH,), robots=1),
    Instance("3 m3pi, a 10 % apart", "three_m3pi.yaml", (BENCH, *with_a(4.6, 4.18, 3.8))),
    Instance("3 m3pi, two a 5 % apart", "three_m3pi.yaml", (BENCH, *with_a(6, 3.15, 3))),
    Instance("3 cells", "tetrahymena.yaml", (CELLS,)),
    Instance("1 cell", "single_cell.yaml", (CELLS,)),
    Instance("round obstacle", "round_obstacle.yaml", (BENCH,)),
    Instance("5 robots, quiet", "five_robots.yaml", (QUIET,)),
    Instance("5 robots", "five_robots.yaml", (BENCH,)),
)


def benchmark() -> list[Instance]:
    """The instances of the benchmark, whose controllers end with their sequence."""
    plain = ("controller.collision.stop_before_collision=false",)
    return [
        Instance(path.stem, f"benchmark/{path.name}", (), controller=plain)
        for path in sorted((EXPERIMENTS / "benchmark").glob("*.yaml"))
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--plans", type=int, default=5)
    parser.add_argument("--benchmark", action="store_true")
    options = parser.parse_args()
    instances = benchmark() if options.benchmark else INSTANCES
    head = ("instance", "unit", "predicted", "mean of trials", "95 % interval")
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    predicted = []
    measured = []
    for instance in instances:
        progress(instance.name)
        spec = instance.experiment()
        seed = spec.trials.seed
        trials = steering(planner(spec), spec.setup, Noise.of(spec.plant), seed, options.plans)
        if trials is None:
            print(f"| {instance.name} | no plan found | | | |", flush=True)
            continue
        errors = np.array([result.total_error for result in run(spec, options.trials)])
        (described,) = distributions(errors[None])
        way = spec.setup.speed.mean() * spec.setup.period_s
        predicted.append(trials.error / way)
        measured.append(float(errors.mean()) / way)
        between = f"{described.ci95.low:.1f} to {described.ci95.high:.1f}"
        means = (f"{trials.error:.1f}", f"{errors.mean():.1f}")
        cells = (instance.name, spec.setup.unit, *means, between)
        print(f"| {' | '.join(cells)} |", flush=True)
    rank = float(scipy.stats.spearmanr(predicted, measured).statistic)
    print(
        "\nrank correlation of predicted error and mean of trials, over "
        f"{len(measured)} instances: {rank:.2f}; per instance {options.trials} trials and "
        f"{options.plans} plans; simulation with assumed noise"
    )


if __name__ == "__main__":
    main()
