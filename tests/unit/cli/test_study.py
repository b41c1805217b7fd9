"""Tests of what `study` says of outdated trials, and how it ends."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from tetractl.cli import study as module
from tetractl.cli.study import ARMS_NAMED, _conclude, _report_outdated, study
from tetractl.core.errors import Exit, UsageError


def test_nothing_is_said_if_no_trial_is_outdated(capsys):
    _report_outdated({})
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("more", [0, 1, 3])
def test_outdated_trials_are_counted_by_arm_and_only_some_arms_named(capsys, more):
    outdated = {f"arm{i}": i + 1 for i in range(ARMS_NAMED + more)}
    _report_outdated(outdated)
    said = capsys.readouterr().err
    assert said.startswith(f"notice: {sum(outdated.values())} trials were run by outdated code")
    assert f"arm{ARMS_NAMED - 1} ({ARMS_NAMED})" in said
    assert f"arm{ARMS_NAMED} " not in said
    assert (f"and {more} more arms" in said) == (more > 0)


def test_a_cluster_and_processes_exclude_each_other():
    with pytest.raises(UsageError, match="give only one of them"):
        study(Path("x.yaml"), jobs=2, cluster="tcp://x")


@pytest.fixture
def conclude(monkeypatch, capsys):
    """End a study of two arms of three trials with some finished ones."""

    def end(complete, aborted=0, interrupted=False):
        trials = [SimpleNamespace(outcome=SimpleNamespace(complete=True))] * complete
        trials += [SimpleNamespace(outcome=SimpleNamespace(complete=False))] * aborted
        table = "tetractl.study.arm_table"
        monkeypatch.setattr(f"{table}.finished_trials", lambda *_: [("arm", t) for t in trials])
        monkeypatch.setattr(f"{table}.write_table", lambda *_: "table.csv")
        monkeypatch.setattr(f"{table}.arms_table", lambda *_: None)
        monkeypatch.setattr("tetractl.study.figure.write_figures", lambda *_: ["figure.svg"])
        monkeypatch.setattr(module, "print_tables", lambda tables: None)
        loaded = SimpleNamespace(
            arms=[1, 2], study=SimpleNamespace(trials=SimpleNamespace(count=3))
        )
        code = _conclude(loaded, None, interrupted)
        said = capsys.readouterr()
        return code, said.out.split(), said.err.splitlines()

    return end


def test_a_whole_study_writes_its_table_and_figures(conclude):
    assert conclude(6) == (Exit.DONE, ["table.csv", "figure.svg"], [])


def test_missing_trials_fail_the_study_and_say_how_to_go_on(conclude):
    code, files, lines = conclude(4)
    assert code == Exit.FAILED
    assert files == ["table.csv", "figure.svg"]
    assert lines == ["2 of 6 trials are missing; to continue, run the same command again"]


def test_aborted_trials_fail_the_study(conclude):
    code, _, lines = conclude(4, aborted=2)
    assert code == Exit.FAILED
    assert lines == ["2 trials aborted"]


def test_an_interrupted_study_draws_nothing(conclude):
    code, files, lines = conclude(4, interrupted=True)
    assert code == Exit.INTERRUPTED
    assert files == ["table.csv"]
    assert lines[-1] == "interrupted"


def test_without_a_finished_trial_nothing_is_written(conclude):
    code, files, lines = conclude(0)
    assert (code, files) == (Exit.FAILED, [])
    assert lines[0].startswith("6 of 6 trials are missing")
