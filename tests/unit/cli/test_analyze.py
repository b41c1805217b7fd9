"""What `analyze` prints if its trials do not all end: no statistics of those that did."""

import json
from contextlib import contextmanager

import pytest
from testkit.running import QUICK

from tetractl.cli import analyze
from tetractl.core.errors import AbortError, Exit
from tetractl.run import executors
from tetractl.run.interrupt import Interrupt

pytestmark = pytest.mark.slow

TRIALS = 3


@pytest.fixture
def spec(tmp_path):
    path = tmp_path / "quick.yaml"
    path.write_text(QUICK)
    return path


@pytest.fixture
def interrupt(monkeypatch):
    """The interrupt that the command listens to, without its handlers of signals."""
    interrupt = Interrupt()

    @contextmanager
    def stoppable(loaded, options):
        yield interrupt

    monkeypatch.setattr(analyze, "stop_on_signals", stoppable)
    return interrupt


def before_trial(monkeypatch, index, action):
    """Let something happen before the trial of this index is run."""
    run_task = executors.run_task

    def run(task, *args):
        if task.trial == index:
            action()
        return run_task(task, *args)

    monkeypatch.setattr(executors, "run_task", run)


@pytest.mark.parametrize("as_json", [True, False])
@pytest.mark.parametrize("index", [0, 1, TRIALS - 1])
def test_an_interrupted_analysis_gives_no_statistics(
    spec, interrupt, monkeypatch, capsys, index, as_json
):
    before_trial(monkeypatch, index, interrupt.request)
    with pytest.raises(KeyboardInterrupt):
        analyze.analyze(spec, TRIALS, as_json=as_json)
    out = capsys.readouterr().out
    assert "interval" not in out
    assert not as_json or out == ""


def fail():
    raise AbortError("the disk is full")


def test_an_analysis_of_which_a_trial_fails_gives_no_statistics(
    spec, interrupt, monkeypatch, capsys
):
    before_trial(monkeypatch, 1, fail)
    with pytest.raises(AbortError, match="the disk is full"):
        analyze.analyze(spec, TRIALS, as_json=True)
    assert capsys.readouterr().out == ""


def test_an_analysis_that_ends_is_of_all_of_its_trials(spec, interrupt, capsys):
    assert analyze.analyze(spec, TRIALS, as_json=True) == Exit.DONE
    assert json.loads(capsys.readouterr().out)["total_error"]["n"] == TRIALS
    assert analyze.analyze(spec, TRIALS) == Exit.DONE
    assert "interval" in capsys.readouterr().out
