"""Tests of reading the trials of studies from logs, each of them once."""

from dataclasses import replace

import pytest
from testkit.batches import batch, experiment
from testkit.studies import FAILING, SMALL, run

from tetractl.core.errors import UsageError
from tetractl.core.plan import Outcome
from tetractl.log.read.trial_log import Origin
from tetractl.run import store
from tetractl.statistics.open_batch import (
    Batch,
    Damaged,
    differences,
    errors_known,
    find_sources,
    is_counted,
    open_batch,
    shared_experiment,
)


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
    listed = [(source.name, len(source.logs)) for source in find_sources(paths)]
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
    monkeypatch.setattr(store, "code_hash", lambda experiment: "newer")
    run(tmp_path, SMALL, rerun_outdated=True)
    assert len(list(arm.glob("*.attempt-1.mcap"))) == 3
    assert trial_numbers(open_batch([arm])) == [0, 1, 2]


def test_the_folder_of_a_study_is_a_batch_per_arm(tmp_path):
    study = arm_of_three_trials(tmp_path).parent
    assert sizes_of([str(study)]) == {"dead_time=0": 3, "dead_time=0.1": 3}
    arms = [source.read() for source in find_sources([str(study)])]
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
        find_sources([demo, elsewhere])


def test_a_pattern_pools_what_it_matches(tmp_path):
    folder_with_a_log(tmp_path / "demo/ours")
    folder_with_a_log(tmp_path / "demo/paper")
    assert len(find_sources([f"{tmp_path}/demo/*/*.mcap"])) == 1


# ---- What makes trials one batch ----

BLOCK = {"type": "circle", "center": [700, 1900], "radius": 50}


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        ({}, {}, []),
        ({"name": "a"}, {"name": "b"}, ["name: a != b"]),
        ({"error_bound": 5.0}, {"description": "why"}, []),  # these change no trial
        ({"trials": {"count": 3}}, {"trials": {"count": 9}}, []),
        (
            {"plant": {"type": "sim", "dead_time": 0.1}},
            {"plant": {"type": "sim"}},
            ["plant.dead_time: 0.1 != 0.0"],
        ),
        (
            {"controller": {"motion": "exact"}, "plant": {"type": "sim", "dead_time": 0.1}},
            {},
            ["controller.motion: exact != euler", "plant.dead_time: 0.1 != 0.0"],
        ),
        ({"obstacles": [BLOCK]}, {"obstacles": []}, ["obstacles"]),
        (
            {"obstacles": [BLOCK, BLOCK]},
            {"obstacles": [BLOCK, BLOCK | {"radius": 51}]},
            ["obstacles.1.radius: 50.0 != 51.0"],
        ),
        ({"hold": {"time": 8, "radius": 30}}, {}, ["hold"]),
    ],
)
def test_the_fields_in_which_two_experiments_differ_are_named_by_their_paths(
    ours, theirs, expected
):
    assert differences(experiment(1, **ours), experiment(1, **theirs)) == expected
    swapped = differences(experiment(1, **theirs), experiment(1, **ours))
    assert [text.partition(":")[0] for text in swapped] == [
        text.partition(":")[0] for text in expected
    ]


SEQUENCE = {"type": "sequence", "period": 0.2, "directions": [0.1]}


def test_directions_differ_only_from_a_controller_that_chose_its_own():
    given = experiment(1, controller=SEQUENCE)
    others = experiment(1, controller=SEQUENCE | {"directions": [0.1, 0.2]})
    assert differences(given, others) == []
    slower = experiment(1, controller=SEQUENCE | {"period": 0.3})
    assert differences(given, slower) == ["controller.period: 0.2 != 0.3"]
    assert differences(given, experiment(1))


def in_lab(trial, digest=None):
    return replace(trial, origin=Origin.LAB, digest=digest)


def test_two_trials_of_a_lab_may_have_one_number_but_not_one_digest():
    first, second = batch([[1.0], [2.0]])
    second = replace(second, trial=first.trial)
    for digests in (("a", "b"), (None, None), ("a", None)):
        trials = [in_lab(first, digests[0]), in_lab(second, digests[1])]
        assert shared_experiment(Batch.from_results(trials)) is first.experiment
    twice = Batch.from_results([in_lab(first, "a"), in_lab(second, "a")])
    with pytest.raises(UsageError, match="contain the same trial"):
        shared_experiment(twice)


def test_two_simulated_trials_may_have_one_number_or_one_seed_but_not_both():
    first, second = batch([[1.0], [2.0]])
    other_seed = replace(second, trial=first.trial, seed=9)
    for trials in ([first, second], [first, other_seed]):
        assert shared_experiment(Batch.from_results(trials)) is first.experiment
    same = replace(second, trial=first.trial, digest="another")
    with pytest.raises(UsageError, match=r"trial-000\.mcap and trial-001\.mcap contain"):
        shared_experiment(Batch.from_results([first, same]))


def stopped(trial):
    return replace(trial, result=replace(trial.result, outcome=Outcome.ABORTED))


def test_only_an_incomplete_trial_is_replaced_by_a_complete_one_of_its_seed_and_number():
    first, second, third = batch([[1.0], [2.0], [3.0]])
    again = replace(first, log="again.mcap")
    for before, later in ((stopped(first), again), (again, stopped(first))):
        both = Batch.from_results([before, second, later])
        assert {trial.log for trial in both.trials} == {"again.mcap", second.log}
        assert [trial.log for trial in both.attempts] == [first.log]
    alone = Batch.from_results([stopped(first), second, third])
    assert [trial.log for trial in alone.trials] == [first.log, second.log, third.log]
    elsewhere = replace(again, seed=9)
    assert len(Batch.from_results([stopped(first), elsewhere]).trials) == 2
    aborted_twice = Batch.from_results([stopped(first), stopped(again)])
    assert len(aborted_twice.trials) == 2


def test_a_batch_is_whole_unless_a_trial_is_damaged_or_lost():
    first, second = batch([[1.0], [2.0]])
    lost = Damaged("trial-002.mcap", "torn")
    set_aside = Damaged("trial-002.attempt-1.mcap", "torn")
    recovered = replace(second, recovered=True)
    assert Batch.from_results([first, second]).whole
    assert Batch.from_results([first, second], [set_aside]).whole
    assert not Batch.from_results([first, second], [lost]).whole
    assert not Batch.from_results([first, recovered]).whole
    mixed = Batch.from_results([first, second], [lost, set_aside])
    assert (mixed.lost, mixed.lost_attempts) == ((lost,), (set_aside,))
    assert repr(mixed) == "Batch(2 trials, 2 damaged)"


def test_a_trial_counts_if_it_ran_to_its_end_with_known_errors_in_a_whole_log():
    (first,) = batch([[1.0]])
    assert is_counted(first)
    assert not is_counted(replace(first, recovered=True))
    assert errors_known(replace(first, recovered=True))
    for outcome in (Outcome.ABORTED, Outcome.INTERRUPTED):
        assert not is_counted(replace(first, result=replace(first.result, outcome=outcome)))
    for unknown in ({"total_error": float("nan")}, {"robot_errors": (float("inf"),)}):
        assert not is_counted(replace(first, result=replace(first.result, **unknown)))


def test_progress_is_told_after_each_log_and_what_cannot_be_read_is_kept(tmp_path):
    folder_with_a_log(tmp_path / "a")
    folder_with_a_log(tmp_path / "b")
    told = []
    (source,) = find_sources([f"{tmp_path}/*/trial-000.mcap"])
    damaged = source.read(lambda done, count: told.append((done, count))).damaged
    assert told == [(1, 2), (2, 2)]
    assert [log.problem for log in damaged] == ["the file is empty"] * 2
