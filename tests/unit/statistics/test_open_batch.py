"""Trials of studies, read from their logs: each once, whatever is in the folder."""

import pytest
from support.studies import FAILING, SMALL, run

from tetractl.core.errors import UsageError
from tetractl.run import store
from tetractl.statistics.open_batch import open_batch, sources


def arm_of_three_trials(folder, last_are_brief=True):
    """Run a study; return the folder of one arm. Its logs are whole, or those of the last two
    trials brief."""
    run(folder, SMALL, whole_logs=True)
    if last_are_brief:
        for log in folder.glob("out/*/trial-00[12].mcap"):
            log.unlink()
        run(folder, SMALL)
    return folder / "out" / "dead_time=0.1"


def whole_logs(batch):
    """Whether the log of each trial that counts is whole; none is damaged, no trial twice."""
    whole_by_trial = {trial.trial: not trial.brief for trial in batch.trials}
    assert len(whole_by_trial) == len(batch.trials)
    assert list(batch.damaged) == []
    return whole_by_trial


def sizes_of(paths):
    """The number of logs of each batch, by its name."""
    listed = [(source.name, len(source.logs)) for source in sources(paths)]
    assert len(dict(listed)) == len(listed)
    return dict(listed)


def test_whole_and_brief_logs_are_read_alike(tmp_path):
    arm = arm_of_three_trials(tmp_path)
    mixed = {0: True, 1: False, 2: False}
    batch = open_batch([arm])
    assert whole_logs(batch) == mixed
    assert [log.name for log in batch.logs] == ["trial-000.mcap"]
    assert whole_logs(open_batch([str(arm)[:-1] + "*"])) == mixed
    assert whole_logs(open_batch([arm / "*.mcap"])) == mixed


def test_a_path_spelt_twice_gives_each_trial_once(tmp_path, monkeypatch):
    arm = arm_of_three_trials(tmp_path)
    link = tmp_path / "link"
    link.symlink_to(arm)
    monkeypatch.chdir(arm.parent)
    for also_arm in (link, arm.name, f"{arm.name}/trial-000.mcap"):
        assert set(whole_logs(open_batch([also_arm, arm]))) == {0, 1, 2}


def test_a_trial_that_failed_is_counted_once(tmp_path):
    run(tmp_path, FAILING, whole_logs=True)
    failed = open_batch([tmp_path / "out" / "speed=1e+308"])
    assert whole_logs(failed) == {0: True, 1: True, 2: True, 3: True}


@pytest.mark.long
def test_logs_that_were_set_aside_do_not_count(tmp_path, monkeypatch):
    arm = arm_of_three_trials(tmp_path, last_are_brief=False)
    monkeypatch.setattr(store, "code_of", lambda experiment: "newer")
    run(tmp_path, SMALL, rerun_outdated=True)
    assert len(list(arm.glob("*.attempt-1.mcap"))) == 3
    assert whole_logs(open_batch([arm])) == {0: False, 1: False, 2: False}


def test_the_folder_of_a_study_is_a_batch_per_arm(tmp_path):
    study = arm_of_three_trials(tmp_path).parent
    assert sizes_of([str(study)]) == {"dead_time=0": 3, "dead_time=0.1": 3}
    arms = [source.read() for source in sources([str(study)])]
    assert [len(arm.trials) for arm in arms] == [3, 3]


def folder_with_a_log(path):
    path.mkdir(parents=True)
    (path / "trial-000.mcap").write_bytes(b"")
    return str(path)


def test_batches_are_called_by_their_folders(tmp_path):
    x = folder_with_a_log(tmp_path / "b/x")
    y = folder_with_a_log(tmp_path / "b/y")
    assert list(sizes_of([x, y])) == ["x", "y"]


def test_a_folder_of_folders_with_logs_is_a_batch_for_each(tmp_path):
    folder_with_a_log(tmp_path / "demo/ours")
    folder_with_a_log(tmp_path / "demo/paper")
    elsewhere = folder_with_a_log(tmp_path / "elsewhere")
    demo = str(tmp_path / "demo")
    assert sizes_of([demo]) == {"ours": 1, "paper": 1}
    with pytest.raises(UsageError, match="holds 2 batches"):
        sources([demo, elsewhere])


def test_a_pattern_pools_what_it_matches(tmp_path):
    folder_with_a_log(tmp_path / "demo/ours")
    folder_with_a_log(tmp_path / "demo/paper")
    assert len(sources([f"{tmp_path}/demo/*/*.mcap"])) == 1
