"""How many whole trials a minute a study runs: with logs and without, in one process and in two.

Run `python benchmarks/study.py` on an idle machine. Each round runs every case once, one after
another, so that cases are compared within a round. A rate is that of the trials after the first
ones, which also wait for processes to start.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from tetractl.run.batch import Ending, run_batch
from tetractl.run.executors import on_this_machine
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import Task
from tetractl.study.load_study import load_study
from tetractl.study.missing_trials import Logs, lacking

ROOT = Path(__file__).parents[1]
CASES = {
    "1 process, whole logs": (1, "all"),
    "1 process, brief logs": (1, "none"),
    "2 processes, whole logs": (2, "all"),
    "2 processes, brief logs": (2, "none"),
}


class Clocked:
    """A `RunObserver` that notes when trials end [s]."""

    def __init__(self) -> None:
        self.ends_s: list[float] = []

    def trial_started(self, task: Task) -> None:
        """Ignore the start."""

    def trial_ended(self, ending: Ending) -> None:
        """Note the time; a failure ends the benchmark, which is not of trials that fail."""
        if ending.failure:
            raise SystemExit(ending.failure)
        self.ends_s.append(time.perf_counter())


def measure(spec: Path, trials: int, jobs: int, logs: str) -> float:
    """Run a study of one arm; return whole trials a minute."""
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "study.yaml"
        file.write_text(f"name: rate\nbase: {spec}\ntrials: {{count: {trials}, seed: 1}}\n")
        loaded = load_study(file)
        clocked = Clocked()
        store = loaded.store(Path(name) / "out")
        with store.opened():
            tasks, _ = lacking(loaded, store, Logs.parse(logs), False)
            executor = on_this_machine(jobs, len(tasks), Interrupt())
            run_batch(tasks, store, executor, clocked)
    first = 2 * jobs
    took_s = clocked.ends_s[-1] - clocked.ends_s[first - 1]
    return 60 * (trials - first) / took_s


def main() -> None:
    """Print the median of the rounds for each case, and the gain of the second process."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--spec", type=Path, default=ROOT / "experiments" / "three_m3pi.yaml")
    parser.add_argument("--trials", type=int, default=100, help="trials of each case in a round")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    measured: dict[str, list[float]] = {name: [] for name in CASES}
    for _ in range(options.rounds):
        for name, (jobs, logs) in CASES.items():
            measured[name].append(measure(options.spec.resolve(), options.trials, jobs, logs))
    print(
        f"{options.spec.name}, {options.rounds} rounds of {options.trials} trials, median (range)"
    )
    for name, values in measured.items():
        print(f"{name:23} {_span(values, 0)} trials a minute")
    for logs in ("whole logs", "brief logs"):
        single = measured[f"1 process, {logs}"]
        two = measured[f"2 processes, {logs}"]
        gains = [b / a for a, b in zip(single, two, strict=True)]
        print(f"2 processes against 1, {logs}: {_span(gains, 2)}x")


def _span(values: list[float], digits: int) -> str:
    """Return median and range of some values."""
    middle, low, high = (f"{f(values):.{digits}f}" for f in (statistics.median, min, max))
    return f"{middle} ({low} to {high})"


if __name__ == "__main__":
    main()
