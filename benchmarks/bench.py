"""Compares the same trials on the simulated bench and in the emulated lab.

    python benchmarks/bench.py [--trials N]

The emulated lab, with its radio, robots, firmware and our program, runs in virtual time, so that a
busy computer does not change the result. tests/testkit/emulator/bench_agreement.py lists what both
have in common. The output is Markdown.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import scipy

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from testkit.emulator.bench_agreement import bench_spec, bench_trial, lab_spec, lab_trial


def main() -> None:
    """Run both kinds of trials, and compare them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=20, metavar="N")
    trials = range(parser.parse_args().trials)
    batches = {
        "bench without noise, slip and lost frames": [
            bench_trial(bench_spec(), trial).result for trial in trials
        ],
        "emulated lab": [lab_trial(lab_spec(), trial).result for trial in trials],
    }
    print("| | complete | total error [mm], mean +- standard deviation |\n|---|--:|--:|")
    errors = []
    for name, results in batches.items():
        total = np.array([result.total_error for result in results])
        complete = sum(result.outcome.complete for result in results)
        mean = f"{total.mean():.1f} +- {total.std(ddof=1):.1f}"
        print(f"| {name} | {complete} of {len(total)} | {mean} |")
        errors.append(total)
    ks = scipy.stats.ks_2samp(*errors)
    print(f"\nKolmogorov-Smirnov: D = {ks.statistic:.2f}, p = {ks.pvalue:.2f}.")


if __name__ == "__main__":
    main()
