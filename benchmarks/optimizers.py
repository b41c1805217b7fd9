"""Compares every installed optimiser on step 0 of the reference experiment.

    python benchmarks/optimizers.py              20 seeds, about ten seconds for each optimiser
    python benchmarks/optimizers.py --seeds 3

Each optimiser searches 44 signals once, with its default settings and without a warm start. J is in
mm.
"""

import argparse
import time

import numpy as np
from solverbench.problems import LENGTH, printed, recommended
from solverbench.report import describe_load

from tetractl.core.plan import Limits, Problem
from tetractl.core.registries import OPTIMIZERS
from tetractl.spec.controller import OptimizerSection


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20, help="searches by each optimiser")
    seeds = parser.parse_args().seeds
    print("| problem | optimiser | J, median | J, worst | time, median [ms] |")
    print("|---|---|---|---|---|")
    for name, problem in (("as printed", printed()), ("as recommended", recommended())):
        for kind in OPTIMIZERS.names():
            optimizer = OPTIMIZERS.load(kind).model_validate({"type": kind})
            print(f"| {name} | `{kind}` | {_figures(optimizer, problem, seeds)} |", flush=True)
    print(f"\n{seeds} searches of {LENGTH} signals each, {describe_load()}.")


def _figures(optimizer: OptimizerSection, problem: Problem, seeds: int) -> str:
    optimizer.search(problem, LENGTH, None, 0, Limits())  # compile
    costs = []
    times = []
    for key in range(seeds):
        begin = time.perf_counter()
        plan = optimizer.search(problem, LENGTH, None, key, Limits())
        times.append((time.perf_counter() - begin) * 1e3)
        costs.append(plan.cost)
    return f"{np.median(costs):.3g} | {np.max(costs):.3g} | {np.median(times):.1f}"


if __name__ == "__main__":
    main()
