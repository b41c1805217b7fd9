"""Runs trials in real time that can be killed, and examines what is left of their logs."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from testkit.running import ENDLESS
from tetractl.core.errors import LogError
from tetractl.log.read.reader import read_trial

CHILD = """
import sys, time
from contextlib import ExitStack
from pathlib import Path
from tetractl.core.clock import MonotonicClock
from tetractl.control.methods.build import warm_up
from tetractl.run.checked_controller import build_controller
from tetractl.core.trial import SIMULATED_START_NS, PlantInfo, Start
from tetractl.log.write.writer import LogWriter
from tetractl.core.protocols import LabSupervision
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import trial_seeds
from tetractl.run.control_loop import Trial
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import create_start

spec = parse_spec(sys.argv[1], "spec.yaml")
warm_up(spec.experiment, print)
key, seed = trial_seeds(1, 0)
interrupt = Interrupt()
writer = LogWriter(Path(sys.argv[2]), real_time=True)
with interrupt.watch(), writer:
    clock = MonotonicClock()
    print(time.monotonic_ns(), flush=True)
    start = create_start(spec, 0, PlantInfo("", True, 0.0, {}), SIMULATED_START_NS)
    plant = spec.experiment.plant.build(spec.experiment.setup, clock, seed, LabSupervision())
    controller = build_controller(spec.experiment, key)
    result = Trial(start, plant, controller, clock, [writer], interrupt).run()
print(result.outcome.value, "|", result.reason, "|", result.steps, flush=True)
"""
"""A trial in real time, its log written as in the lab, but of simulated robots."""


@dataclass(frozen=True)
class Killed:
    """What a kill cost: `lost_s` of the trial, of which `ran_s` had gone."""

    ran_s: float
    lost_s: float
    steps: int


class RealTime:
    """A trial in real time in a process of its own."""

    def __init__(self, path: Path, spec: str = ENDLESS, **env: str) -> None:
        self.path = path
        self.process = subprocess.Popen(
            [sys.executable, "-c", CHILD, spec, str(path)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | env,
        )
        first = self.process.stdout.readline()
        while first and not first.strip().isdigit():  # it may say that it compiles
            first = self.process.stdout.readline()
        assert first, self.process.communicate()[1]
        self.began_ns = int(first)

    def now_s(self) -> float:
        """Time of the trial."""
        return (time.monotonic_ns() - self.began_ns) / 1e9

    def kill(self) -> Killed:
        """Kill it with -9 and look what its log still holds."""
        ran = self.now_s()
        self.process.kill()
        self.process.communicate()
        try:
            log = read_trial(self.path.with_name(self.path.name + ".part"))
        except LogError:  # killed before its head was written: nothing had moved
            return Killed(ran, ran, 0)
        assert is_without_gaps([step.k for step in log.steps])
        assert is_without_gaps(log.frames.tolist())
        last = max([0, *log.received_ns[-1:], *(c.sent_ns for c in log.commands[-1:])])
        return Killed(ran, ran - float(last) / 1e9, len(log.steps))

    def ask(self, number: signal.Signals) -> str:
        """Ask it to stop; return what it said."""
        self.process.send_signal(number)
        return self.end()

    def end(self) -> str:
        """Wait until it ends; return what it said."""
        out, err = self.process.communicate(timeout=600)
        assert self.process.returncode == 0, err
        return out


def is_without_gaps(numbers: list[int]) -> bool:
    """Whether they are 0, 1, 2 and so on."""
    return numbers == list(range(len(numbers)))


def random_kill(path: Path, rng: random.Random, most_s: float = 4.0) -> Killed:
    """Kill a trial within its first seconds."""
    trial = RealTime(path)
    kill_s = rng.uniform(0.3, most_s)
    time.sleep(max(0.0, kill_s - trial.now_s()))
    return trial.kill()


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """Mount a file system of `size`; root only."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    subprocess.run(mount, check=True, capture_output=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True, capture_output=True)
