"""Trials of studies, read from their logs: each once, whatever is in the folder."""

import pytest
from support.studies import FAILING, SMALL, run

from tetractl.core.errors import UsageError
from tetractl.results.open_batch import Source, open_batch, sources
from tetractl.run import store
from tetractl.study.options import Logs

ALL, FIRST, NONE = Logs(float("inf"), True), Logs(1, False), Logs(0, False)


def arm_of(folder, logs):
    """The folder of an arm of three trials."""
    run(folder, SMALL, logs=logs)
    return folder / "out" / "dead_time=0.1"


def read(*paths):
    """Whether the log of each trial that counts is whole, and which logs are damaged."""
    found = open_batch(paths)
    whole = {trial.trial: not trial.brief for trial in found.trials}
    return whole, len(found.trials), list(found.damaged)


def test_whole_and_brief_logs_are_read_alike(tmp_path):
    arm = arm_of(tmp_path, FIRST)
    mixed = {0: True, 1: False, 2: False}
    assert read(arm) == (mixed, 3, [])
    assert read(str(arm)[:-1] + "*") == (mixed, 3, [])
    assert read(arm / "*.mcap") == (mixed, 3, [])
    assert [log.name for log in open_batch([arm]).logs] == ["trial-000.mcap"]


def test_a_path_spelt_twice_gives_each_trial_once(tmp_path, monkeypatch):
    arm = arm_of(tmp_path, FIRST)
    (tmp_path / "link").symlink_to(arm)
    monkeypatch.chdir(arm.parent)
    for paths in ([arm, tmp_path / "link"], [arm.name, arm], [f"{arm.name}/trial-000.mcap", arm]):
        assert read(*paths)[1:] == (3, [])


def test_a_trial_that_failed_is_counted_once(tmp_path):
    run(tmp_path, FAILING, logs=Logs(0, True))
    assert read(tmp_path / "out" / "speed=1e+308") == (dict.fromkeys(range(4), True), 4, [])


def test_logs_that_were_set_aside_do_not_count(tmp_path, monkeypatch):
    arm = arm_of(tmp_path, ALL)
    monkeypatch.setattr(store, "code_of", lambda experiment: "newer")
    run(tmp_path, SMALL, logs=NONE, rerun_outdated=True)
    assert len(list(arm.glob("*.attempt-1.mcap"))) == 3
    assert read(arm) == (dict.fromkeys(range(3), False), 3, [])


def test_the_folder_of_a_study_is_a_batch_per_arm_listed_once(tmp_path):
    arm = arm_of(tmp_path, FIRST)
    study = arm.parent
    found = sources([str(study)])
    assert [(one.name, len(one.logs)) for one in found] == [
        ("dead_time=0", 3),
        ("dead_time=0.1", 3),
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
