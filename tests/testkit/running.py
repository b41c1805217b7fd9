"""Runs `tetractl run` in a process that can be sent signals, and examines what it leaves behind."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from tetractl.core.plan import Outcome
from tetractl.log.read.reader import read_trial

BIN = Path(sys.executable).parent
TETRACTL = BIN / "tetractl"
PATIENCE_S = 600  # before a test gives up; nothing waits for it to pass

QUICK = """\
name: quick
arena: {left: 0, bottom: 0, width: 2000, height: 1000}
robots: [{name: r, start: [100, 500], target: [300, 500], a: 6, speed: 200}]
controller: {type: pso-mpc, horizon_max: 6, steps_max: 6,
  optimizer: {type: pso, particles: 10, iterations: 10}}
plant: {type: sim, camera_rate: 20, measurement_noise: {position: 1}, lost_commands: 0.1}
trials: {count: 3, seed: 7}
"""
ENDLESS = (
    QUICK.replace("width: 2000", "width: 1.0e+9")
    .replace("[300, 500]", "[9.0e+8, 500]")
    .replace("steps_max: 6", "steps_max: 1000000")
)
HEAVY = ENDLESS.replace("horizon_max: 6", "horizon_max: 2000").replace(
    "particles: 10, iterations: 10", "particles: 100, iterations: 1000, stop: {type: budget}"
)


def first_of(values, also=()):
    """Parameters of a test of processes: `make test` runs the first, `make test-ci` the rest; of
    those, if another test finds what they would, only what is `also` named."""
    first, *rest = values
    later = [pytest.mark.system, *([pytest.mark.release] if also else [])]
    marks = [[pytest.mark.system] if value in also else later for value in rest]
    pairs = zip(rest, marks, strict=True)
    return [first, *(pytest.param(value, marks=marks) for value, marks in pairs)]


def take_signals():
    """Let processes that tests start take signals, also under `nohup` and behind `&`.

    Ignored signals stay ignored in a new program, but handled ones get their default there.
    """
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, lambda *_: None)


def environment():
    return {k: v for k, v in os.environ.items() if not k.startswith(("COLUMNS", "_TETRACTL"))}


class Started:
    """A command in a session of its own, with what it prints in files, but for the standard
    `streams` that are given."""

    def __init__(self, cwd, *words, **streams):
        self.out = cwd / "out-said"
        self.err = cwd / "err-said"
        with self.out.open("w") as out, self.err.open("w") as err:
            self.process = subprocess.Popen(
                [TETRACTL, *map(str, words)],
                cwd=cwd,
                env=environment(),
                start_new_session=True,
                **{"stdout": out, "stderr": err} | streams,
            )

    def until(self, condition):
        """Watch until something can be seen."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert self.process.poll() is None, self.err.read_text()
            assert time.monotonic() < deadline
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(0.02)

    def printed(self):
        """All it printed so far."""
        return self.out.read_text() + self.err.read_text()

    def end(self):
        code = self.process.wait(PATIENCE_S)
        assert "Traceback" not in self.err.read_text(), self.err.read_text()
        return code

    def __enter__(self):
        return self

    def __exit__(self, *_):
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


class Running(Started):
    """A run of a spec, with its logs in `logs`."""

    def __init__(self, folder, spec, *args, **streams):
        self.logs = folder / "logs"
        (folder / "spec.yaml").write_text(spec)
        super().__init__(folder, "run", "spec.yaml", "--out", "logs", *args, **streams)

    def until_logging(self, trials, size=0):
        """Until so many trials have written more than `size` bytes of log."""

        def are_logging():
            sizes = [part.stat().st_size for part in self._parts()]
            return sum(size_now > size for size_now in sizes) >= trials

        self.until(are_logging)

    def _parts(self):
        return list(self.logs.glob("*.part")) if self.logs.exists() else []

    def workers(self):
        """Process ids of the workers, those that still start too: children of the server of forks,
        as the process that tracks semaphores has none."""
        children = (worker for child in _children(self.process.pid) for worker in _children(child))
        return [pid for pid in children if is_worker(pid)]

    def end(self):
        code = super().end()
        assert self._parts() == []
        return code


def _children(pid):
    with suppress(OSError):
        numbers = Path(f"/proc/{pid}/task/{pid}/children").read_text()
        return [int(number) for number in numbers.split()]
    return []


def child_of(parent, module):
    """The id of the process that another one has started to run a Python module; None without."""
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended
            is_child = f"PPid:\t{parent}\n" in (entry / "status").read_text()
            if is_child and module.encode() in (entry / "cmdline").read_bytes():
                return int(entry.name)
    return None


def is_worker(pid):
    """Whether a process is, still, a worker that the server of forks has started."""
    with suppress(OSError):
        return b"multiprocessing.forkserver" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def assert_interrupted(running, trials, reason=""):
    logs = [read_trial(path) for path in sorted(running.logs.glob("*.mcap"))]
    assert len(logs) == trials
    for log in logs:
        assert log.damage is None
        assert log.stop is not None
        assert log.result.outcome is Outcome.INTERRUPTED
        assert log.result.reason.startswith(reason)
        assert len(log.steps) == log.result.steps
    last = running.err.read_text().splitlines()[-1]
    assert last == "interrupted; to continue, run the same command again with --out logs --resume"
    assert "interrupted" in running.out.read_text()
