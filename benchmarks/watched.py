"""What it costs a run in the emulated lab to be watched; no hardware.

    python benchmarks/watched.py [--trials N]

Runs trials in real time, in turn alone, with the live view on a terminal, served with no viewer
looking, served to a viewer that reads every topic, and served to one that reads nothing. Prints
Markdown: late control steps, the age of the newest frame when a command leaves, and the CPU time of
the run's process a second of driving.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [
    str(ROOT / one) for one in ("tests", "benchmarks", "packages/tetractl-emulator/tests")
]

from lab import LOCAL, latency_ms  # noqa: E402
from support.lab_processes import SPEC, TETRACTL, Emulator, flags  # noqa: E402
from support.terminal import Terminal  # noqa: E402
from support.viewer import Viewer, deaf  # noqa: E402

from tetractl.log.format.channels import CHANNELS  # noqa: E402
from tetractl.log.read.reader import read_trial  # noqa: E402
from tetractl.log.read.trial_log import TrialLog  # noqa: E402

SERVE = ["--quiet", "--serve", "--port", "0"]
TICK_S = 1 / 100  # of the kernel's count of CPU time


@dataclass
class Way:
    """A way to be watched: what it adds to the command, and who connects; with what came of it."""

    name: str
    words: list[str]
    screen: bool = False
    connect: Callable[[str, ExitStack], object] | None = None
    logs: list[TrialLog] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)  # a trial


def read_all(url: str, stack: ExitStack) -> None:
    """Read everything, in a thread."""
    viewer = stack.enter_context(Viewer(url)).subscribe()

    def read() -> None:
        with suppress(Exception):  # the end of the connection
            while True:
                viewer.socket.recv()

    threading.Thread(target=read, daemon=True).start()


def read_nothing(url: str, stack: ExitStack) -> None:
    """Subscribe to everything and read none of it."""
    stack.enter_context(deaf(url, len(CHANNELS)))


def run(way: Way, folder: Path) -> None:
    """Run one trial in an emulated lab of its own."""
    folder.mkdir()
    settings = (*LOCAL, "trials.count=1")
    emulator = Emulator(folder, settings)
    try:
        ready = emulator.wait_for("ready")
        settings += (
            f"lab.camera.command_port={ready['command_port']}",
            f"lab.actuator.port={ready['port']}",
        )
        command = [TETRACTL, "run", str(SPEC), "--plant", "lab", "--yes", "--out", "logs"]
        command += [*way.words, *flags(settings)]
        times = [(time.time(), 0.0)]
        code, said = (on_terminal if way.screen else in_pipe)(way, command, folder, times)
        if code != 0:
            why = re.findall(r"error: [^\r\n]*", said)
            print(f"\n({way.name}: exit code {code}: {why})\n", flush=True)
            return
        log = read_trial(folder / "logs" / "trial-000.mcap")
    finally:
        emulator.close()
    way.logs.append(log)
    began_s = (log.start.start_unix_ns + log.began_ns) / 1e9
    ends_s = began_s + log.result.duration_s
    wall, cpu = np.array(times).T
    used = np.interp([began_s, ends_s], wall, cpu)
    way.cpu.append((used[1] - used[0]) / (ends_s - began_s))


def on_terminal(
    way: Way, command: list[str], folder: Path, times: list[tuple[float, float]]
) -> tuple[int, str]:
    """Run a command on a terminal; return its exit code and what it said."""
    with Terminal(command, folder, 120, 40) as terminal:
        threading.Thread(target=sample, args=(terminal.process.pid, times)).start()
        return terminal.finish(), terminal.raw


def in_pipe(
    way: Way, command: list[str], folder: Path, times: list[tuple[float, float]]
) -> tuple[int, str]:
    """Run a command without a terminal, and connect once it says where it is served."""
    said = ""
    with (
        ExitStack() as stack,
        subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, cwd=folder,
        ) as process,
    ):  # fmt: skip
        threading.Thread(target=sample, args=(process.pid, times)).start()
        for line in process.stdout or ():
            said += line
            if way.connect and line.startswith("served at "):
                way.connect(line.split()[-1], stack)
        return process.wait(), said


def sample(pid: int, times: list[tuple[float, float]]) -> None:
    """Note the time and the CPU time of a process [s] until it ends."""
    with suppress(OSError, IndexError):
        while True:
            spent = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            times.append((time.time(), (int(spent[11]) + int(spent[12])) * TICK_S))
            time.sleep(0.05)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=5, metavar="N")
    trials = parser.parse_args().trials
    ways = [
        Way("alone", ["--quiet"]),
        Way("live view", [], screen=True),
        Way("served, no viewer", SERVE),
        Way("served, one reads all", SERVE, connect=read_all),
        Way("served, one reads nothing", SERVE, connect=read_nothing),
    ]
    with tempfile.TemporaryDirectory() as folder:
        for trial in range(trials):
            for number, way in enumerate(ways):  # in turn, so that the machine's load is shared
                run(way, Path(folder) / f"{trial}-{number}")
    print("| emulated lab | trials | steps | late | age [ms] p50 | p99 | max | CPU [%] |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|")
    for way in ways:
        if not way.logs:
            continue
        late = sum(step.deadline_missed for log in way.logs for step in log.steps)
        steps = sum(len(log.steps) for log in way.logs)
        age = latency_ms(way.logs)
        p50, p99 = np.percentile(age, (50, 99))
        cpu = 100 * np.array(way.cpu)
        print(
            f"| {way.name} | {len(way.logs)} | {steps} | {late} | {p50:.1f} | {p99:.1f} | "
            f"{age.max():.1f} | {cpu.mean():.1f} ({cpu.min():.1f} to {cpu.max():.1f}) |"
        )


if __name__ == "__main__":
    main()
