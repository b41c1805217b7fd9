"""Tests of what `run` refuses, prints before it runs, and makes of a report."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from testkit.batches import result
from testkit.paths import ROOT

from tetractl.cli import trials
from tetractl.cli.trials import (
    DEFAULT_PORT,
    RunOptions,
    _conclude,
    _describe_limits,
    _list_planned,
    _print_plan,
    choose_port,
    new_log_folder,
    run_command,
)
from tetractl.core.errors import Exit, LogError, UsageError
from tetractl.core.plan import Outcome
from tetractl.core.trial import Verdict
from tetractl.run.batch import Report
from tetractl.run.interrupt import Interrupt
from tetractl.spec.load import load_spec, parse_spec
from tetractl.spec.plants import select_plant

SPEC = parse_spec(
    """
name: s
arena: {left: 0, bottom: 0, width: 100, height: 100}
robots:
  - {name: one, start: [10, 10], target: [20, 20], a: 3, speed: 20}
  - {name: two, start: [10, 30], target: [20, 40], a: 2, speed: 30}
controller: {type: pso-mpc, period: 0.1, time_limit: 50}
trials: {count: 5}
""",
    "s.yaml",
)
LAB = select_plant(load_spec(ROOT / "experiments/three_m3pi_lab.yaml"), "lab")


@pytest.mark.parametrize(
    ("serve", "port", "wanted"),
    [(False, None, None), (True, None, DEFAULT_PORT), (True, 9000, 9000)],
)
def test_trials_are_served_only_with_serve(serve, port, wanted):
    assert choose_port(serve, port) == wanted


def test_a_port_needs_serve():
    with pytest.raises(UsageError, match="--port needs --serve"):
        choose_port(False, 9000)


def test_a_new_folder_is_in_logs_and_named_after_the_experiment():
    folder = new_log_folder("s")
    assert folder.parent == Path("logs")
    assert folder.name.startswith("s-2")
    assert folder.name.endswith("Z")


REFUSED = {
    "two at a time in a lab": (LAB, {"jobs": 2}, "--jobs works only in virtual time"),
    "a speed in a lab": (LAB, {"rate": 2.0}, "--rate works only in virtual time"),
    "unattended simulations": (SPEC, {"unattended": True}, "--unattended is only for robots"),
    "and with yes": (SPEC, {"unattended": True, "yes": True}, "--unattended is only for robots"),
    "unattended, and nobody said yes": (LAB, {"unattended": True}, "--unattended is only for"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_options_that_do_not_fit_the_plant_are_refused(case, tmp_path):
    spec, options, says = REFUSED[case]
    with pytest.raises(UsageError, match=says):
        run_command(spec, RunOptions(out=tmp_path / "out", dry_run=True, **options))
    assert not (tmp_path / "out").exists()


INNOCENT = {
    "two at a time": (SPEC, {"jobs": 2}),
    "slowly": (SPEC, {"rate": 1.0}),
    "in a lab": (LAB, {}),
    "unattended in a lab": (LAB, {"unattended": True, "yes": True}),
}


@pytest.mark.parametrize("case", INNOCENT)
def test_a_dry_run_runs_and_writes_nothing(case, tmp_path, capsys):
    spec, options = INNOCENT[case]
    folder = tmp_path / "out"
    assert run_command(spec, RunOptions(out=folder, dry_run=True, **options)) == (Exit.DONE, folder)
    assert not folder.exists()
    assert "nothing is run or written" in capsys.readouterr().out


def test_what_would_run_is_printed_as_a_spec(capsys):
    _print_plan(SPEC, Path("out"), [0, 1, 4])
    text = capsys.readouterr().out
    assert parse_spec(text, "printed").experiment == SPEC.experiment
    assert "# Trials to run: 3 of 5\n" in text
    assert "# Logs to write: out/trial-000.mcap ... out/trial-004.mcap\n" in text
    _print_plan(SPEC, Path("out"), [2])
    assert "# Logs to write: out/trial-002.mcap\n" in capsys.readouterr().out
    _print_plan(SPEC, Path("out"), [])
    text = capsys.readouterr().out
    assert "# Trials to run: 0 of 5" in text
    assert "Logs to write" not in text


def test_the_limits_of_a_trial_follow_from_its_controller_and_its_fastest_robot():
    limits = _describe_limits(SPEC.experiment)
    assert limits["control period"] == "0.1 s"
    assert limits["duration of a trial"] == "at most 50 s after the first command"
    assert limits["path of a robot"] == "at most 1500 mm"
    assert "the trial aborts" in _describe_limits(LAB.experiment)


def test_one_trial_or_those_that_lack_are_run():
    store = SimpleNamespace(unfinished=[2, 3])
    assert _list_planned(store, None) == [2, 3]
    assert _list_planned(store, 0) == [0]


# the end


@pytest.fixture(autouse=True)
def _no_statistics(monkeypatch):
    monkeypatch.setattr(trials, "_print_statistics", lambda *_, **__: None)


GOOD = result([1.0])
VERDICT = Verdict(GOOD.verdict.final, (False,), (1.0,))


def aborted(can_restart=True):
    verdict = VERDICT if can_restart else Verdict.unknown(1)
    return result([1.0], outcome=Outcome.ABORTED, reason="it fell", verdict=verdict)


def conclude(report, planned=(0, 1), aborted_before=(), in_lab=False):
    store = SimpleNamespace(folder=Path("logs"), aborted=aborted_before)
    return _conclude(report, list(planned), Interrupt(), in_lab, store, as_json=False)


def test_a_whole_run_tells_where_its_logs_are_and_how_to_look_at_the_first(capsys):
    report = Report({("", 4): GOOD, ("", 3): GOOD})
    assert conclude(report, [3, 4]) == Exit.DONE
    first, second = capsys.readouterr().err.splitlines()
    assert first == (
        "logs are in logs; this command prints all figures: tetractl stats logs --full"
    )
    assert second == "look at one of them with: tetractl replay logs/trial-003.mcap"


def test_an_aborted_trial_fails_the_run_and_is_named_with_its_number(capsys):
    report = Report({("", 0): GOOD, ("", 1): aborted()})
    assert conclude(report) == Exit.FAILED
    lines = capsys.readouterr().err.splitlines()
    assert lines[1:] == ["error: trial 2: it fell"]


def test_trials_that_were_not_run_are_counted_and_keep_going_is_suggested(capsys):
    assert conclude(Report({("", 0): aborted()}), [0, 1, 2]) == Exit.FAILED
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("logs are in logs; 2 trials were not run; this command")
    assert lines[-1] == "hint: with --keep-going, a batch goes on after an abort like this one"


def test_keep_going_is_not_suggested_if_somebody_must_touch_a_robot_first(capsys):
    assert conclude(Report({("", 0): aborted(can_restart=False)}), [0, 1]) == Exit.FAILED
    assert "--keep-going" not in capsys.readouterr().err
    assert conclude(Report({("", 0): aborted()}), [0]) == Exit.FAILED
    assert "--keep-going" not in capsys.readouterr().err


def test_a_run_fails_while_its_folder_has_an_aborted_trial():
    assert conclude(Report({("", 0): GOOD}), [0], aborted_before=(1,)) == Exit.FAILED


def test_nothing_left_to_run_is_a_whole_run(capsys):
    assert conclude(Report(), []) == Exit.DONE
    assert "trial-000.mcap" in capsys.readouterr().err


def test_an_error_without_any_result_is_all_that_is_said(capsys):
    error = LogError("no space")
    with pytest.raises(LogError, match="no space"):
        conclude(Report(errors={("", 0): error}))
    assert capsys.readouterr().err == ""


def test_an_error_after_results_is_raised_when_these_are_told(capsys):
    report = Report({("", 0): GOOD}, errors={("", 1): LogError("no space")})
    with pytest.raises(LogError, match="no space"):
        conclude(report)
    assert "logs are in logs" in capsys.readouterr().err


INTERRUPTED = result([1.0], outcome=Outcome.INTERRUPTED)


@pytest.mark.parametrize(
    ("results", "is_interrupted"),
    [
        ([INTERRUPTED], True),
        ([GOOD, INTERRUPTED], True),
        ([aborted(), INTERRUPTED], True),
        ([INTERRUPTED, aborted()], False),
    ],
)
def test_an_interrupted_run_can_be_continued_unless_its_last_trial_was_aborted(
    capsys, results, is_interrupted
):
    code = conclude(Report({("", i): one for i, one in enumerate(results)}), range(3))
    assert ("--resume" in capsys.readouterr().err) == is_interrupted
    assert code == (Exit.INTERRUPTED if is_interrupted else Exit.FAILED)


@pytest.mark.parametrize(("planned", "is_interrupted"), [([0], False), ([0, 1], True)])
def test_a_signal_after_the_last_trial_interrupts_nothing(planned, is_interrupted):
    interrupt = Interrupt()
    interrupt.request()
    store = SimpleNamespace(folder=Path("logs"), aborted=())
    report = Report({("", 0): GOOD})
    code = _conclude(report, planned, interrupt, False, store, as_json=False)
    assert code == (Exit.INTERRUPTED if is_interrupted else Exit.DONE)


def test_statistics_that_cannot_be_written_are_the_error_of_a_whole_run(monkeypatch):
    full = OSError(28, "No space left")
    monkeypatch.setattr(trials, "_print_statistics", lambda *_, **__: full)
    with pytest.raises(OSError, match="No space left"):
        conclude(Report({("", 0): GOOD}), [0])
