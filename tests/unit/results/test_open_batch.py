"""Trials of studies, read from logs and rows together: each once, whatever is in the folder."""

import json
import os

import pytest
from support.studies import FAILING, SMALL, run

from tetractl.core.errors import UsageError
from tetractl.log.format.channels import RESOLVED_SPEC
from tetractl.log.read.find import ROWS
from tetractl.results.open_batch import Source, open_batch, sources
from tetractl.study.options import Logs

ALL, FIRST, NONE = Logs(float("inf"), True), Logs(1, False), Logs(0, False)


def arm_of(folder, logs):
    """The folder of an arm of three trials."""
    run(folder, SMALL, logs=logs)
    return folder / "out" / "dead_time=0.1"


def edit(arm, **fields):
    rows = [json.loads(line) | fields for line in (arm / ROWS).read_text().splitlines()]
    (arm / ROWS).write_text("".join(json.dumps(row) + "\n" for row in rows))


def read(*paths):
    """The numbers of the trials that count, whether each is from a log, and what is damaged."""
    found = open_batch(paths)
    logged = {trial.trial: trial.path.endswith(".mcap") for trial in found.trials}
    return logged, len(found.trials), list(found.damaged)


def test_trials_with_a_log_are_read_from_it_and_the_others_from_their_rows(tmp_path):
    arm = arm_of(tmp_path, FIRST)
    mixed = {0: True, 1: False, 2: False}
    assert read(arm) == (mixed, 3, [])
    assert read(str(arm)[:-1] + "*") == (mixed, 3, [])
    assert read(arm / "*.mcap") == ({0: True}, 1, [])


def test_a_path_spelt_twice_gives_each_trial_once(tmp_path, monkeypatch):
    arm = arm_of(tmp_path, FIRST)
    (tmp_path / "link").symlink_to(arm)
    monkeypatch.chdir(arm.parent)
    for paths in ([arm, tmp_path / "link"], [arm.name, arm], [f"{arm.name}/trial-000.mcap", arm]):
        assert read(*paths)[1:] == (3, [])


def test_a_trial_that_failed_is_counted_once(tmp_path):
    run(tmp_path, FAILING, logs=Logs(0, True))
    (arm,) = {path.parent for path in (tmp_path / "out").rglob("trial-*.mcap")}
    assert read(arm) == (dict.fromkeys(range(4), True), 4, [])


def test_a_log_that_was_set_aside_hides_no_row(tmp_path):
    arm = arm_of(tmp_path, ALL)
    edit(arm, code="older")
    run(tmp_path, SMALL, logs=NONE, rerun_outdated=True)
    assert len(list(arm.glob("*.attempt-1.mcap"))) == 3
    assert read(arm) == (dict.fromkeys(range(3), False), 3, [])


def test_a_log_that_lost_its_end_is_damaged_and_its_row_counts(tmp_path):
    arm = arm_of(tmp_path, ALL)
    log = arm / "trial-001.mcap"
    whole = log.read_bytes()
    log.write_bytes(whole[: len(whole) // 2])
    (arm / "trial-002.mcap").write_bytes(b"")
    found, count, damaged = read(arm)
    assert (found, count) == ({0: True, 1: False, 2: False}, 3)
    assert sorted(one.path for one in damaged) == [str(arm / f"trial-00{i}.mcap") for i in (1, 2)]


def test_rows_without_a_result_are_missed_only_where_there_is_no_log(tmp_path):
    arm = arm_of(tmp_path, FIRST)
    edit(arm, result={}, timing={})
    found, count, damaged = read(arm)
    assert (found, count) == ({0: True}, 1)
    (one,) = damaged
    assert (one.path, one.problem.partition(";")[0]) == (
        str(arm / ROWS), "2 trials have neither a readable log nor a readable row"
    )  # fmt: skip
    assert [task.key for task in run(tmp_path, SMALL, logs=FIRST).tasks] == [
        (arm.name, trial) for trial in (1, 2)
    ]
    run(tmp_path, SMALL, logs=FIRST, rerun_outdated=True)
    assert read(arm) == ({0: True, 1: False, 2: False}, 3, [])


def test_a_spec_of_other_rows_is_damage_that_the_study_mends(tmp_path):
    arm = arm_of(tmp_path, NONE)
    whole = (arm / RESOLVED_SPEC).read_text()
    (arm / RESOLVED_SPEC).write_text(whole.replace("seed: 7", "seed: 8"))
    assert read(arm)[1] == 0
    run(tmp_path, SMALL, logs=NONE)
    assert (arm / RESOLVED_SPEC).read_text() == whole
    assert read(arm)[1:] == (3, [])


def test_rows_that_are_no_file_are_refused(tmp_path):
    arm = arm_of(tmp_path, NONE)
    (arm / ROWS).unlink()
    os.mkfifo(arm / ROWS)
    with pytest.raises(UsageError, match="is not a regular file"):
        open_batch([arm])


def test_the_folder_of_a_study_is_a_batch_per_arm_listed_once(tmp_path):
    arm = arm_of(tmp_path, FIRST)
    study = arm.parent
    found = sources([str(study)])
    assert [(one.name, len(one.logs), len(one.rows)) for one in found] == [
        ("dead_time=0", 1, 1),
        ("dead_time=0.1", 1, 1),
    ]
    assert [len(one.read().trials) for one in found] == [3, 3]
    with pytest.raises(UsageError, match="holds 2 batches"):
        sources([str(study), str(arm)])
    (study / "trial-000.mcap").write_bytes(b"of no arm")
    assert len(sources([str(study)])) == 1


def test_batches_are_called_by_their_folders_and_by_their_paths_where_those_are_alike(tmp_path):
    for name in ("a/x", "b/x", "b/y"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "one.mcap").write_bytes(b"")
    x, also_x, y = (str(tmp_path / name) for name in ("a/x", "b/x", "b/y"))
    assert [one.name for one in sources([x, y])] == ["x", "y"]
    assert [one.name for one in sources([x, also_x])] == [x, also_x]
    assert Source.of([f"{x}/*.mcap", y]).name == f"{x}/*.mcap and 1 more"


def test_a_folder_of_folders_with_logs_is_a_batch_for_each(tmp_path):
    for name in ("demo/ours", "demo/paper", "other"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "trial-000.mcap").write_bytes(b"")
    demo = tmp_path / "demo"
    assert [(one.name, len(one.logs)) for one in sources([str(demo)])] == [
        ("ours", 1),
        ("paper", 1),
    ]
    assert len(sources([f"{demo}/*/*.mcap"])) == 1  # a pattern pools
    with pytest.raises(UsageError, match="holds 2 batches"):
        sources([str(demo), str(tmp_path / "other")])
