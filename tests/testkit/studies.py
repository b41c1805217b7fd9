"""A quick study, and `tetractl study` in a process that can be killed."""

from typing import Any, NamedTuple

from testkit import cli
from testkit.running import QUICK, Started
from tetractl.run.batch import OnFailure, run_batch
from tetractl.run.executors import local_executor
from tetractl.run.interrupt import Interrupt
from tetractl.study.arm_table import finished_trials, write_table
from tetractl.study.load_study import load_study
from tetractl.study.missing_trials import unfinished_tasks

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


def write(folder, study=STUDY, spec=QUICK):
    folder.mkdir(exist_ok=True)
    (folder / "spec.yaml").write_text(spec)
    path = folder / "study.yaml"
    path.write_text(study)
    return path


def tetractl(*args, cwd, env=None):
    return cli.tetractl(cwd, *args, env=env)


def logs(out):
    """Number of finished logs that a study's folder holds."""
    return len([path for path in out.glob("*/trial-*.mcap") if ".attempt-" not in path.name])


def results(out):
    """All files of a study that every way to run it must give alike, by name."""
    paths = [out / "trials.csv", *sorted(out.glob("*.png"))]
    return {path.name: path.read_bytes() for path in paths}


class Running(Started):
    """A study in a session of its own."""

    def __init__(self, cwd, *args):
        super().__init__(cwd, "study", *args)

    def until_logs(self, out, count):
        self.until(lambda: logs(out) >= count)


def run(folder, study=STUDY, spec=QUICK, out="out", **options):
    """Run a study in this process; return the study, its store and what became of the trials."""
    loaded = load_study(write(folder, study, spec))
    store = loaded.store(folder / out)
    watcher = Watcher()
    with store.opened():
        rerun_outdated = options.get("rerun_outdated", False)
        tasks, outdated = unfinished_tasks(loaded, store, rerun_outdated)
        executor = options.get("executor") or local_executor(
            options.get("jobs", 1), len(tasks), Interrupt()
        )
        on_failure = options.get("on_failure", OnFailure.GO_ON)
        report = run_batch(tasks, store, executor, watcher, on_failure)
        write_table(loaded, store)
    return Ran(loaded, store, tasks, outdated, report, watcher)


class Ran(NamedTuple):
    loaded: Any
    store: Any
    tasks: Any
    outdated: Any
    report: Any
    watcher: Any

    @property
    def finished(self):
        """Results by arm and trial."""
        finished = finished_trials(self.loaded, self.store)
        return {(arm.name, trial.trial): trial for arm, trial in finished}

    @property
    def counts(self):
        """The numbers of trials with a result, with an error, and with neither."""
        return len(self.report.results), len(self.report.errors), self.report.remaining


class Watcher:
    """A `RunObserver` that keeps what it was called with."""

    def __init__(self):
        self.started = []
        self.endings = []

    @property
    def failures(self):
        return [(*end.task.key, end.failure) for end in self.endings if end.failure]

    def trial_started(self, task):
        self.started.append(task.key)

    def trial_ended(self, ending):
        self.endings.append(ending)
