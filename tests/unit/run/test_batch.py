from dataclasses import replace

import pytest
from support import random_trials as made
from support.paths import ROOT

from tetractl.control.rng import mix
from tetractl.core.errors import TetractlError
from tetractl.core.plan import Outcome
from tetractl.experiment.load import load_spec, parse_spec
from tetractl.experiment.plants import on_plant
from tetractl.log.read.reader import read_result, read_trial
from tetractl.run import batch
from tetractl.run.batch import log_path, run_batch, run_trial
from tetractl.run.interrupt import Interrupt
from tetractl.run.seeds import trial_seeds

QUICK = """
name: quick
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots: [{name: r, start: [100, 500], target: [300, 500], a: 6, speed: 200}]
controller: {horizon_max: 5, steps_max: 4, optimizer: {particles: 4, iterations: 3}}
plant: {type: sim, camera_rate: 20, measurement_noise: {position: 1}, heading_noise: 0.1}
trials: {count: 4, seed: 7}
"""
SPEC = parse_spec(QUICK, "quick.yaml")


class Watcher:
    def __init__(self):
        self.told = []

    def trial_started(self, index, n):
        self.told.append(("started", index, n))

    def trial_finished(self, index, result):
        self.told.append(("finished", index, result.outcome))


def scripted(monkeypatch, outcomes, action=lambda trial: None):
    """Trials that end as `outcomes` say, by index, without being run."""
    result = made.trial(1, steps=2, frames=2).result
    ran = []

    def run(spec, folder, trial, observers, interrupt, operators):
        ran.append(trial)
        action(trial)
        return replace(result, outcome=outcomes.get(trial, Outcome.ARRIVED))

    monkeypatch.setattr(batch, "run_trial", run)
    return ran


@pytest.mark.parametrize("jobs", [1, 3])
def test_a_batch_of_nothing_is_done(tmp_path, jobs):
    """Regression: `--jobs 2 --resume` of a complete batch crashed."""
    report = run_batch(SPEC, tmp_path, [], jobs, Interrupt(), Watcher())
    assert (report.results, report.not_run, report.interrupted) == ({}, [], False)


def test_trials_run_in_order_and_are_told(monkeypatch, tmp_path):
    ran, watcher = scripted(monkeypatch, {}), Watcher()
    report = run_batch(SPEC, tmp_path, [0, 2, 3], 1, Interrupt(), watcher)
    assert ran == list(report.results) == [0, 2, 3]
    assert watcher.told == [
        event
        for trial in (0, 2, 3)
        for event in (("started", trial, 4), ("finished", trial, Outcome.ARRIVED))
    ]
    assert (report.not_run, report.interrupted, report.aborted) == ([], False, {})


def test_an_aborted_trial_ends_the_batch(monkeypatch, tmp_path):
    ran = scripted(monkeypatch, {1: Outcome.ABORTED})
    report = run_batch(SPEC, tmp_path, range(4), 1, Interrupt(), Watcher())
    assert ran == [0, 1]
    assert (list(report.aborted), report.not_run, report.interrupted) == ([1], [2, 3], False)


def test_an_interrupted_trial_ends_the_batch(monkeypatch, tmp_path):
    interrupt = Interrupt()
    scripted(
        monkeypatch, {1: Outcome.INTERRUPTED}, lambda trial: trial == 1 and interrupt.request()
    )
    report = run_batch(SPEC, tmp_path, range(4), 1, interrupt, Watcher())
    assert (report.not_run, report.interrupted) == ([2, 3], True)


def test_an_interruption_between_two_trials_is_one_too(monkeypatch, tmp_path):
    """Regression: it came too late for the trial under way, and the batch ended as if done."""
    interrupt = Interrupt()
    scripted(monkeypatch, {}, lambda trial: trial == 1 and interrupt.request())
    report = run_batch(SPEC, tmp_path, range(4), 1, interrupt, Watcher())
    assert (list(report.results), report.not_run, report.interrupted) == ([0, 1], [2, 3], True)


def test_an_interruption_after_the_last_trial_changes_nothing(monkeypatch, tmp_path):
    interrupt = Interrupt()
    scripted(monkeypatch, {}, lambda trial: trial == 3 and interrupt.request())
    report = run_batch(SPEC, tmp_path, range(4), 1, interrupt, Watcher())
    assert (report.not_run, report.interrupted) == ([], False)


def test_a_trial_is_logged_under_its_number_with_its_seeds(tmp_path):
    result = run_trial(SPEC, tmp_path, 2, (), Interrupt())
    assert [path.name for path in tmp_path.iterdir()] == ["trial-002.mcap"]
    log = read_trial(log_path(tmp_path, 2))
    assert log.result == replace(result, verdict=log.result.verdict)
    assert (log.start.trial, log.start.seed, log.damage) == (2, 7, None)
    assert log.steps[0].plan.generator == mix(trial_seeds(7, 2)[0], 0)
    assert len(set(log.frames.tolist())) == len(log.frames) > 10


def test_a_trial_repeats_itself_whatever_ran_before(tmp_path):
    alone, among = tmp_path / "alone", tmp_path / "among"
    for folder, trials in ((alone, [1]), (among, [0, 1, 2])):
        folder.mkdir()
        run_batch(SPEC, folder, trials, 1, Interrupt(), Watcher())
    digests = [read_result(log_path(folder, 1)).digest for folder in (alone, among)]
    assert digests[0] == digests[1]
    others = {read_result(log_path(among, trial)).digest for trial in range(3)}
    assert len(others) == 3


def test_logs_are_numbered_with_three_digits_or_more(tmp_path):
    assert log_path(tmp_path, 7).name == "trial-007.mcap"
    assert log_path(tmp_path, 12345).name == "trial-12345.mcap"


def test_a_clock_before_1970_is_refused_before_anything_is_opened(monkeypatch, tmp_path):
    lab = on_plant(load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml"), "lab")
    monkeypatch.setattr(batch.time, "time_ns", lambda: -1)
    with pytest.raises(TetractlError, match="this computer's clock is before 1970"):
        run_trial(lab, tmp_path, 0, (), Interrupt())
    assert list(tmp_path.iterdir()) == []
