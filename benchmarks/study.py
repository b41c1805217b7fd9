"""How many whole trials a minute a study runs: with logs and without, in one process and in two.

Run `python benchmarks/study.py` on an idle machine. Each round runs every case once, one after
another, so that cases are compared within a round. A rate is that of the trials after the first
ones, which also wait for processes to start. CPU time depends less on what else the machine does:
that of a trial is what its worker spends from its start to its end, that elsewhere is what this
process spends on handing trials out and storing rows.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from tetractl.run.batch import Ending, run_batch
from tetractl.run.executors import on_this_machine
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import Task
from tetractl.study.load_study import load_study
from tetractl.study.options import Logs, lacking

ROOT = Path(__file__).parents[1]
CASES = {
    "1 process, all logs": (1, "all"),
    "1 process, no logs": (1, "none"),
    "2 processes, all logs": (2, "all"),
    "2 processes, no logs": (2, "none"),
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


class Measured(NamedTuple):
    """Whole trials a minute, and CPU time a trial [ms]: in the trial, and elsewhere in here; the
    longest control step of a trial, which is its first plan [ms], and the share of a trial's CPU
    time that is none of its control steps'."""

    rate: float
    trial_ms: float
    here_ms: float
    first_ms: float
    outside: float


def measure(spec: Path, trials: int, jobs: int, logs: str) -> Measured:
    """Run a study of one arm."""
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "study.yaml"
        file.write_text(f"name: rate\nbase: {spec}\ntrials: {{count: {trials}, seed: 1}}\n")
        loaded, clocked = load_study(file), Clocked()
        store = loaded.store(Path(name) / "out")
        with store.opened():
            tasks, _ = lacking(loaded, store, Logs.parse(logs), False)
            executor = on_this_machine(jobs, len(tasks), Interrupt())
            before_s = time.process_time()
            run_batch(tasks, store, executor, clocked)
            here_s = time.process_time() - before_s
        first = 2 * jobs
        rows = list(store.batches[loaded.arms[0].name].rows.values())
        used_s = [row.cpu_s for row in rows]
        first_ms = [1e-6 * max(row.result.solve_ns) for row in rows]
        solved_s = sum(1e-9 * sum(row.result.solve_ns) for row in rows)
    took_s = clocked.ends_s[-1] - clocked.ends_s[first - 1]
    if jobs == 1:
        here_s -= sum(used_s)
    rate = 60 * (trials - first) / took_s
    trial_ms, outside = 1e3 * statistics.median(used_s), 1 - solved_s / sum(used_s)
    return Measured(rate, trial_ms, 1e3 * here_s / trials, statistics.mean(first_ms), outside)


def main() -> None:
    """Print the median of the rounds for each case, and the gain of the second process."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--spec", type=Path, default=ROOT / "experiments" / "three_m3pi.yaml")
    parser.add_argument("--trials", type=int, default=100, help="trials of each case in a round")
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    found: dict[str, list[Measured]] = {name: [] for name in CASES}
    for _ in range(asked.rounds):
        for name, (jobs, logs) in CASES.items():
            found[name].append(measure(asked.spec.resolve(), asked.trials, jobs, logs))
    print(f"{asked.spec.name}, {asked.rounds} rounds of {asked.trials} trials, median (range)")
    for name, values in found.items():
        rates, trial_ms, here_ms, first_ms, outside = map(list, zip(*values, strict=True))
        print(
            f"{name:22} {_span(rates, 0)} trials a minute, CPU {_span(trial_ms, 0)} ms a trial,"
            f" {_span([100 * share for share in outside], 0)} % of it outside the solver, and"
            f" {_span(here_ms, 1)} ms elsewhere; first plan {_span(first_ms, 1)} ms on average"
        )
    for logs in ("all logs", "no logs"):
        one, two = found[f"1 process, {logs}"], found[f"2 processes, {logs}"]
        gains = [b.rate / a.rate for a, b in zip(one, two, strict=True)]
        print(f"2 processes against 1, {logs}: {_span(gains, 2)}x")


def _span(values: list[float], digits: int) -> str:
    """Return median and range of some values."""
    middle, low, high = (f"{f(values):.{digits}f}" for f in (statistics.median, min, max))
    return f"{middle} ({low} to {high})"


if __name__ == "__main__":
    main()
