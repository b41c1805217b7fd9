"""The lab's figures, measured against the emulated lab in real time; no hardware.

    python benchmarks/lab.py [--trials N] [--seconds S] [--skip-batch]

Prints Markdown: NatNet parse cost and PyPI's `natnet`'s, control-to-wheel latency (exposure of the
frame a command is based on to the command having left), frames dropped, deadline misses at 5, 20
and 120 Hz control, and the errors of lab trials next to simulated ones with the same dead time.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / one) for one in ("tests", "packages/tetractl-emulator/tests")]

from support.lab_processes import SPEC, TETRACTL, Emulator, flags  # noqa: E402
from tetractl_emulator.optitrack.natnet_server import pack_answer  # noqa: E402

from tetractl.lab.cameras.optitrack import natnet  # noqa: E402
from tetractl.lab.cameras.optitrack.wire import HEADER, parse  # noqa: E402
from tetractl.log.read.reader import read_trial  # noqa: E402
from tetractl.log.read.trial_log import TrialLog  # noqa: E402

LOCAL = (
    "lab.camera.transport=unicast",
    "lab.camera.server=127.0.0.1",
    "lab.camera.interface=127.0.0.1",
    "lab.limits.placing=60",
    "lab.limits.late_steps=100000",
)
ATTEMPTS = 6
RADIO_S = 0.007  # from handing over a broadcast to the wheels, as the emulated radio takes


def parse_cost() -> None:
    """Time our parser and natnet's on the same frames of 3 and 20 rigid bodies."""
    from natnet.data_frame import DataFrame
    from natnet.packet_buffer import PacketBuffer
    from natnet.version import Version as TheirVersion

    print("| rigid bodies | tetractl [us] | natnet [us] | ratio |\n|--:|--:|--:|--:|")
    version = natnet.Version(3, 0)
    for count in (3, 20):
        bodies = tuple(
            natnet.RigidBody(i, (0.1, 0.2, 0.3), (0.0, 0.0, 0.0, 1.0), True) for i in range(count)
        )
        data = pack_answer(natnet.NatNetFrame(1, bodies, exposure=1), version)
        ours = best_of(lambda data=data: parse(data, version))
        theirs = best_of(
            lambda data=data: DataFrame.read_from_buffer(
                PacketBuffer(data[HEADER.size :]), TheirVersion(3, 0)
            )
        )
        print(f"| {count} | {ours:.1f} | {theirs:.1f} | {theirs / ours:.1f} |")


def best_of(call, rounds: int = 7, calls: int = 2000) -> float:
    """Return microseconds a call, the best of some rounds."""
    best = float("inf")
    for _ in range(rounds):
        began = time.perf_counter()
        for _ in range(calls):
            call()
        best = min(best, (time.perf_counter() - began) / calls)
    return best * 1e6


def batch(folder: Path, sets: Sequence[str], trials: int) -> list[TrialLog]:
    """Run trials in an emulated lab; return their logs."""
    folder.mkdir()
    settings = (*LOCAL, *sets, f"trials.count={trials}")
    emulator = Emulator(folder, settings, "--replace-after", "0.5")
    try:
        ready = emulator.wait_for("ready")
        settings += (
            f"lab.camera.command_port={ready['command_port']}",
            f"lab.actuator.port={ready['port']}",
        )
        for _ in range(ATTEMPTS):  # an aborted trial ends a batch; it is run again
            if run(folder, "--plant", "lab", "--yes", "--resume", *flags(settings)):
                break
    finally:
        emulator.close()
    return [read_trial(path) for path in sorted((folder / "logs").glob("*.mcap"))]


def run(folder: Path, *words: str) -> bool:
    """Run `tetractl run` on the lab's spec; say why where it does not end well."""
    command = [TETRACTL, "run", str(SPEC), "--quiet", "--json", "--out", str(folder / "logs")]
    done = subprocess.run(
        [*command, *words], stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    for line in done.stderr.splitlines():
        if line.startswith("error:"):
            print(f"\n({line})\n", flush=True)
    return done.returncode == 0


def latency_ms(logs: Sequence[TrialLog]) -> np.ndarray:
    """Age, when each wheel command left, of the newest frame that had come by then [ms]."""
    ages = []
    for log in logs:
        sent = np.array([c.sent_ns for c in log.commands if c.direction is not None])
        newest = np.searchsorted(log.received_ns, sent, side="right") - 1
        known = newest >= 0
        ages.append((sent[known] - log.mocap_ns[newest[known]]) / 1e6)
    return np.concatenate(ages)


def dropped(logs: Sequence[TrialLog]) -> tuple[int, int]:
    """Return how many frames are missing inside the logs, and how many there should be."""
    spans = [int(log.frames[-1] - log.frames[0]) + 1 for log in logs]
    return sum(spans) - sum(len(log.frames) for log in logs), sum(spans)


def describe(name: str, values: np.ndarray) -> str:
    """One line of a table."""
    p50, p99 = np.percentile(values, (50, 99))
    return f"| {name} | {len(values)} | {p50:.1f} | {p99:.1f} | {values.max():.1f} |"


def misses(folder: Path, seconds: float) -> None:
    """Run one trial at each control rate and count late steps."""
    print("| control [Hz] | steps | late | solve p50 [ms] | p99 | max |\n|--:|--:|--:|--:|--:|--:|")
    for rate in (5, 20, 120):
        sets = (  # one plan of directions held for 0.2 s, re-planned more or less often
            f"controller.period={1 / rate!r}",
            f"controller.signal_periods={round(rate / 5)}",
            f"controller.steps_max={round(seconds * rate)}",
            f"controller.deadline={0.7 / rate!r}",
        )
        log = batch(folder / f"{rate}", sets, 1)[-1]  # after attempts that were aborted
        solve = np.array([step.solve_ns for step in log.steps[1:]]) / 1e6
        late = sum(step.deadline_missed for step in log.steps)
        p50, p99 = np.percentile(solve, (50, 99))
        print(f"| {rate} | {len(log.steps)} | {late} | {p50:.2f} | {p99:.2f} | {solve.max():.2f} |")


def errors(logs: Sequence[TrialLog]) -> np.ndarray:
    """Total errors of the trials that were run to their end."""
    results = [log.result for log in logs if log.result and log.result.outcome.complete]
    return np.array([result.total_error for result in results])


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=20, metavar="N")
    parser.add_argument("--seconds", type=float, default=8.0, metavar="S")
    parser.add_argument("--skip-batch", action="store_true")
    options = parser.parse_args()
    print("## NatNet parse cost per frame\n", flush=True)
    parse_cost()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        print("\n## Deadline misses\n", flush=True)
        misses(folder, options.seconds)
        if not options.skip_batch:
            compare(folder, options.trials)


def compare(folder: Path, trials: int) -> None:
    """Run a batch in the lab and one in simulation with the lab's dead time."""
    logs = batch(folder / "lab", (), trials)
    ages = latency_ms(logs)
    lost, frames = dropped(logs)
    print(f"\n## {len(logs)} trials in the emulated lab\n", flush=True)
    print("| | n | p50 [ms] | p99 [ms] | max [ms] |\n|---|--:|--:|--:|--:|")
    print(describe("exposure to command sent", ages))
    print(f"\nFrames dropped: {lost} of {frames}.")
    dead_s = round(float(np.median(ages)) / 1e3 + RADIO_S, 4)
    simulated = folder / "sim"
    simulated.mkdir()
    run(simulated, *flags((f"plant.dead_time={dead_s}", f"trials.count={trials}")))
    sims = [read_trial(path) for path in sorted((simulated / "logs").glob("*.mcap"))]
    print(f"\n## Total error [mm]; the simulation has a dead time of {1e3 * dead_s:.1f} ms\n")
    print("| | complete | mean | std | min | max |\n|---|--:|--:|--:|--:|--:|")
    for name, found in (("emulated lab", errors(logs)), ("simulation", errors(sims))):
        std = found.std(ddof=1) if len(found) > 1 else float("nan")
        print(
            f"| {name} | {len(found)} of {trials} | {found.mean():.1f} | {std:.1f} | "
            f"{found.min():.1f} | {found.max():.1f} |"
        )
    outcomes = [log.result.outcome.value for log in logs if log.result]
    print(f"\nOutcomes in the lab: {json.dumps({o: outcomes.count(o) for o in set(outcomes)})}.")


if __name__ == "__main__":
    main()
