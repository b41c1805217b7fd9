"""A quick study, and `tetractl study` in a process of its own that can be killed."""

import os
import signal
import subprocess
import time
from contextlib import suppress
from typing import Any, NamedTuple

from support import cli
from support.running import PATIENCE_S, QUICK, TETRACTL, environment

from tetractl.run.interrupt import Interrupt
from tetractl.study.load import load_study
from tetractl.study.local import Local
from tetractl.study.options import Logs, Shard
from tetractl.study.run import planned, run_study
from tetractl.study.store import Store
from tetractl.study.table import counted_rows, write_tables

STUDY = """\
name: quick
base: spec.yaml
sweep: {type: grid, fields: {plant.dead_time: [0, 0.1], robots.r.a: [3, 6]}}
controllers:
  many: {}
  few: {controller.optimizer.particles: 5}
trials: {count: 5, seed: 7}
"""
SMALL = """\
name: small
base: spec.yaml
sweep: {type: grid, fields: {plant.dead_time: [0, 0.1]}}
trials: {count: 3, seed: 7}
"""
FAILING = """\
name: failing
base: spec.yaml
sweep: {type: grid, fields: {robots.r.speed: [1.0e+308, 200]}}
trials: {count: 4, seed: 7}
"""
LONGER = STUDY.replace("count: 5", "count: 12")


def write(folder, study=STUDY, spec=QUICK):
    folder.mkdir(exist_ok=True)
    (folder / "spec.yaml").write_text(spec)
    path = folder / "study.yaml"
    path.write_text(study)
    return path


def tetractl(*args, cwd, env=None):
    return cli.tetractl(cwd, *args, env=env)


def rows(out):
    """Number of rows that a study's folder holds."""
    return sum(path.read_bytes().count(b"\n") for path in out.glob("*/trials.jsonl"))


def results(out):
    """All files of a study that every way to run it must give alike, by name."""
    paths = [out / "trials.csv", *sorted(out.glob("*.png"))]
    return {path.name: path.read_bytes() for path in paths}


class Running:
    """A study in a session of its own."""

    def __init__(self, cwd, *args):
        self.err = cwd / "err"
        with self.err.open("w") as err:
            self.process = subprocess.Popen(
                [TETRACTL, "study", *map(str, args)],
                cwd=cwd,
                env=environment(),
                stdout=subprocess.DEVNULL,
                stderr=err,
                start_new_session=True,
            )

    def until_rows(self, out, count):
        self.until(lambda: rows(out) >= count)

    def until(self, condition):
        """Watch until something can be seen."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert self.process.poll() is None, self.err.read_text()
            assert time.monotonic() < deadline
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(0.01)

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


def run(folder, study=STUDY, spec=QUICK, out="out", **options):
    """Run a study in this process; return the study, its store and what became of the trials."""
    loaded = load_study(write(folder, study, spec))
    store = Store(folder / out, loaded.arms)
    logs, shard = options.get("logs", Logs(0, False)), options.get("shard", Shard())
    watcher = Watcher()
    with store.opened(loaded.arms):
        plan = planned(loaded, store, logs, shard, options.get("again", False))
        local = Local(
            options.get("jobs", 1),
            Interrupt(),
            lambda task: store.clear(loaded.arms[task.arm], task.trial),
        )
        fail_fast = options.get("fail_fast", False)
        report = run_study(loaded.arms, store, local, plan.tasks, fail_fast, watcher)
        write_tables(loaded, store)
    return Ran(loaded, store, plan, report, watcher)


class Ran(NamedTuple):
    loaded: Any
    store: Any
    plan: Any
    report: Any
    watcher: Any

    @property
    def rows(self):
        """Rows by arm and trial."""
        return {(arm.name, row.trial): row for arm, row in counted_rows(self.loaded, self.store)}


class Watcher:
    def __init__(self):
        self.failures, self.left_s, self.told = [], [], []

    def expected(self, seconds, trials):
        self.told.append(trials)

    def ended(self, left_s):
        self.left_s.append(left_s)

    def failed(self, arm, trial, why):
        self.failures.append((arm, trial, why))
