"""Tests of which trials of a study are still to be run, and of what is said before."""

import pytest
from testkit.studies import STUDY, write

from tetractl.core.errors import TetractlError
from tetractl.study import missing_trials
from tetractl.study.load_study import load_study
from tetractl.study.missing_trials import dry_run, unfinished_tasks, warm_up_arms

ARMS = 8
TRIALS = 5


class FakeBatch:
    """Stands for the folder of an arm."""

    def __init__(self, lacking, outdated):
        self.unfinished = lacking
        self.outdated = outdated


class FakeStore:
    def __init__(self, batches):
        self.batches = batches


@pytest.fixture
def loaded(tmp_path):
    return load_study(write(tmp_path, STUDY))


def store_of(loaded, *of_arms):
    """Folders whose first arms lack some trials and have some outdated ones; others are done."""
    batches = {arm.name: FakeBatch([], []) for arm in loaded.arms}
    for arm, (missing, outdated) in zip(loaded.arms, of_arms, strict=False):
        batches[arm.name] = FakeBatch(missing, outdated)
    return FakeStore(batches)


def keys(tasks):
    return [task.key for task in tasks]


def test_nothing_is_run_where_nothing_is_missing(loaded):
    assert unfinished_tasks(loaded, store_of(loaded), rerun_outdated=True) == ([], {})


def test_missing_trials_are_ordered_by_number_then_by_arm(loaded):
    first, second, third = (arm.name for arm in loaded.arms[:3])
    store = store_of(loaded, ([3, 1], []), ([1], []), ([0, 3], []))
    tasks, outdated = unfinished_tasks(loaded, store, rerun_outdated=False)
    assert keys(tasks) == [(third, 0), (first, 1), (second, 1), (first, 3), (third, 3)]
    assert outdated == {}
    codes = {arm.name: arm.code_hash for arm in loaded.arms}
    assert all(task.code_hash == codes[task.arm] for task in tasks)


@pytest.mark.parametrize("rerun", [True, False])
def test_outdated_trials_are_counted_or_run_again(loaded, rerun):
    first, second = (arm.name for arm in loaded.arms[:2])
    store = store_of(loaded, ([4], [0, 2]), ([], []))
    tasks, outdated = unfinished_tasks(loaded, store, rerun)
    if rerun:
        assert keys(tasks) == [(first, 0), (first, 2), (first, 4)]
        assert outdated == {}
    else:
        assert keys(tasks) == [(first, 4)]
        assert outdated == {first: 2}
    assert store.batches[first].unfinished == [4]  # those of the folder stay
    assert second not in outdated


def test_a_dry_run_says_how_many_trials_each_arm_lacks(loaded, tmp_path):
    store = store_of(loaded, ([0, 1, 2], []), ([2], []))
    tasks, _ = unfinished_tasks(loaded, store, rerun_outdated=False)
    table = dry_run(loaded, tmp_path / "out", tasks)
    assert table.title.startswith(f"quick: a run would add 4 of {ARMS * TRIALS} trials to ")
    assert table.title.endswith("out")
    rows = list(table.rows)
    assert [row[0] for row in rows] == [arm.name for arm in loaded.arms]
    assert [row[2] for row in rows] == ["3", "1"] + ["0"] * (ARMS - 2)
    assert rows[0][1] == ", ".join(loaded.arms[0].sets)


def test_each_controller_is_compiled_once_and_a_failure_stops_nothing(loaded, monkeypatch):
    warmed = []

    def warm_up(experiment, announce):
        warmed.append(experiment)
        raise TetractlError("no compiler")

    monkeypatch.setattr(missing_trials, "warm_up", warm_up)
    warm_up_arms(loaded, print)
    particles = [experiment.controller.optimizer.particles for experiment in warmed]
    assert len(particles) == 2
    assert particles[1] == 5
