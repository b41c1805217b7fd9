"""The simulated bench and the emulated lab: the same trials, and whether they differ.

    python benchmarks/bench.py [--trials N]

The emulated lab's radio, robots, firmware and our side of it run in virtual time here, so that a
loaded host changes nothing; see the emulator's tests/support/bench_agreement.py for what both have
alike. Prints Markdown.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import stats

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.extend(map(str, Path(__file__).parents[1].glob("packages/*/tests")))

from support.bench_agreement import bench_spec, bench_trial, lab_spec, lab_trial

from tetractl.core.trial import Result


def row(name: str, results: Sequence[Result]) -> str:
    """One line of the table."""
    e = np.array([result.total_error for result in results])
    steps = np.array([result.steps for result in results])
    complete = sum(result.outcome.complete for result in results)
    mean = f"{e.mean():.1f} +- {e.std(ddof=1):.1f}"
    extremes = f"{e.min():.1f} to {e.max():.1f}"
    cells = f"{mean} | {np.median(e):.1f} | {extremes} | {steps.mean():.0f}"
    return f"| {name} | {complete} of {len(e)} | {cells} |"


def main() -> None:
    """Run both and compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=20, metavar="N")
    count = parser.parse_args().trials
    sims = [bench_trial(bench_spec(), trial).result for trial in range(count)]
    labs = [lab_trial(lab_spec(), trial).result for trial in range(count)]
    print("| | complete | total error [mm] | median | range | steps |")
    print("|---|--:|--:|--:|--:|--:|")
    print(row("bench without noise, slip and lost frames", sims))
    print(row("emulated lab", labs))
    sim_errors = np.array([result.total_error for result in sims])
    lab_errors = np.array([result.total_error for result in labs])
    ks = stats.ks_2samp(sim_errors, lab_errors)

    def difference(a: np.ndarray, b: np.ndarray) -> float:
        mean_ln_of_b = np.log(b).mean()
        return float(np.log(a).mean() - mean_ln_of_b)

    permuted = stats.permutation_test((sim_errors, lab_errors), difference, rng=1)
    print(f"\nKolmogorov-Smirnov: D = {ks.statistic:.2f}, p = {ks.pvalue:.2f}. ", end="")
    ratio = float(np.exp(difference(sim_errors, lab_errors)))
    print(f"Geometric mean of the bench over the lab's: {ratio:.2f}, permutation ", end="")
    print(f"p = {permuted.pvalue:.2f}.")


if __name__ == "__main__":
    main()
