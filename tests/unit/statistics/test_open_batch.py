"""Tests of reading the trials of studies from logs, each of them once."""

import pytest
from testkit.studies import FAILING, SMALL, run

from tetractl.core.errors import UsageError
from tetractl.run import store
from tetractl.statistics.open_batch import open_batch, sources


def arm_of_three_trials(folder):
    """Run a study; return the folder of one arm."""
    run(folder, SMALL)
    return folder / "out" / "dead_time=0.1"


def trial_numbers(batch):
    """The numbers of the trials that count; none is damaged, none is there twice."""
    numbers = [trial.trial for trial in batch.trials]
    assert len(set(numbers)) == len(numbers)
    assert list(batch.damaged) == []
    return sorted(numbers)


def sizes_of(paths):
    """The number of logs of each batch, by its name."""
    listed = [(source.name, len(source.logs)) for source in sources(paths)]
    assert len(dict(listed)) == len(listed)
    return dict(listed)


def test_an_arm_is_read_by_its_folder_a_pattern_or_its_logs(tmp_path):
    arm = arm_of_three_trials(tmp_path)
    batch = open_batch([arm])
    assert trial_numbers(batch) == [0, 1, 2]
    assert sorted(log.name for log in batch.logs) == [f"trial-00{k}.mcap" for k in range(3)]
    assert trial_numbers(open_batch([str(arm)[:-1] + "*"])) == [0, 1, 2]
    assert trial_numbers(open_batch([arm / "*.mcap"])) == [0, 1, 2]


def test_a_path_spelt_twice_gives_each_trial_once(tmp_path, monkeypatch):
    arm = arm_of_three_trials(tmp_path)
    link = tmp_path / "link"
    link.symlink_to(arm)
    monkeypatch.chdir(arm.parent)
    for also_arm in (link, arm.name, f"{arm.name}/trial-000.mcap"):
        assert trial_numbers(open_batch([also_arm, arm])) == [0, 1, 2]


def test_a_trial_that_failed_is_counted_once(tmp_path):
    run(tmp_path, FAILING)
    failed = open_batch([tmp_path / "out" / "speed=1e+308"])
    assert trial_numbers(failed) == [0, 1, 2, 3]


@pytest.mark.long
def test_logs_that_were_set_aside_do_not_count(tmp_path, monkeypatch):
    arm = arm_of_three_trials(tmp_path)
    monkeypatch.setattr(store, "code_of", lambda experiment: "newer")
    run(tmp_path, SMALL, rerun_outdated=True)
    assert len(list(arm.glob("*.attempt-1.mcap"))) == 3
    assert trial_numbers(open_batch([arm])) == [0, 1, 2]


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
