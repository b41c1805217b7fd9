"""How many whole trials a minute a study runs: with logs and without, in one process and in two.

Run `python benchmarks/study.py` on an idle machine. Each round runs every case once, one after
another, so that cases are compared within a round. A rate is that of the trials after the first
ones, which also wait for processes to start. The CPU time is that of all processes, their start
included.
"""

import argparse
import resource
import statistics
import tempfile
import time
from pathlib import Path

from tetractl.run.interrupt import Interrupt
from tetractl.study.load import load_study
from tetractl.study.local import Local
from tetractl.study.options import Logs, Shard
from tetractl.study.run import planned, run_study
from tetractl.study.store import Store

ROOT = Path(__file__).parents[1]
CASES = {
    "1 process, all logs": (1, "all"),
    "1 process, no logs": (1, "none"),
    "2 processes, all logs": (2, "all"),
    "2 processes, no logs": (2, "none"),
}


class Clocked:
    """A `StudyObserver` that notes when trials end [s]."""

    def __init__(self) -> None:
        self.ends_s: list[float] = []

    def expected(self, seconds: float, trials: int) -> None:
        """Ignore the estimate."""

    def ended(self, left_s: float | None) -> None:
        """Note the time."""
        self.ends_s.append(time.perf_counter())

    def failed(self, arm: str, trial: int, why: str) -> None:
        """End the benchmark: it is not of trials that fail."""
        raise SystemExit(f"{arm}/{trial}: {why}")


def cpu_s() -> float:
    """Return the CPU time of this process and of those that have ended [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def measure(spec: Path, trials: int, jobs: int, logs: str) -> tuple[float, float]:
    """Return whole trials a minute, and CPU time a trial [ms]."""
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "study.yaml"
        file.write_text(f"name: rate\nbase: {spec}\ntrials: {{count: {trials}, seed: 1}}\n")
        loaded, clocked = load_study(file), Clocked()
        store = Store(Path(name) / "out", loaded.arms)
        with store.opened(loaded.arms):
            tasks = planned(loaded, store, Logs.parse(logs), Shard(), False).tasks
            arm = loaded.arms[0]
            local = Local(jobs, Interrupt(), lambda task: store.clear(arm, task.trial))
            before_s = cpu_s()
            run_study(loaded.arms, store, local, tasks, False, clocked)
            used_s = cpu_s() - before_s
    first = 2 * jobs
    took_s = clocked.ends_s[-1] - clocked.ends_s[first - 1]
    return 60 * (trials - first) / took_s, 1e3 * used_s / trials


def main() -> None:
    """Print the median of the rounds for each case, and the gain of the second process."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--spec", type=Path, default=ROOT / "experiments" / "three_m3pi.yaml")
    parser.add_argument("--trials", type=int, default=100, help="trials of each case in a round")
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in CASES}
    for _ in range(asked.rounds):
        for name, (jobs, logs) in CASES.items():
            found[name].append(measure(asked.spec.resolve(), asked.trials, jobs, logs))
    print(f"{asked.spec.name}, {asked.rounds} rounds of {asked.trials} trials, median (range)")
    for name, values in found.items():
        rates, cpus = zip(*values, strict=True)
        print(
            f"{name:22} {statistics.median(rates):6.0f} trials a minute"
            f" ({min(rates):.0f} to {max(rates):.0f}), {statistics.median(cpus):.0f} ms CPU a trial"
        )
    for logs in ("all logs", "no logs"):
        one, two = found[f"1 process, {logs}"], found[f"2 processes, {logs}"]
        gains = [b[0] / a[0] for a, b in zip(one, two, strict=True)]
        print(
            f"2 processes against 1, {logs}: {statistics.median(gains):.2f}x"
            f" ({min(gains):.2f} to {max(gains):.2f})"
        )


if __name__ == "__main__":
    main()
