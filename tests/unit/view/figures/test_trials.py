"""Which trials a figure draws, how they and their robots are called, and where they ended."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import cut_short, three_robots

from tetractl.core.errors import LogError, UsageError
from tetractl.view.figures.trials import (
    NAME_LENGTH,
    NUMBERED_MIN,
    describe_incompleteness,
    find_final_poses,
    group_by_folder,
    robot_labels,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def trial():
    return three_robots()


def logged_to(trial, *paths):
    return [replace(trial, log=path) for path in paths]


def test_trials_are_grouped_by_the_names_of_their_folders(trial):
    logs = logged_to(trial, "logs/ours/0.mcap", "logs/paper/0.mcap", "logs/ours/1.mcap", "2.mcap")
    groups = group_by_folder(logs)
    assert {name: [log.log for log in group] for name, group in groups.items()} == {
        "ours": ["logs/ours/0.mcap", "logs/ours/1.mcap"],
        "paper": ["logs/paper/0.mcap"],
        "trials": ["2.mcap"],
    }


def test_folders_of_one_name_are_called_by_their_paths(trial):
    assert list(group_by_folder(logged_to(trial, "a/ours/0.mcap", "b/ours/0.mcap"))) == [
        "a/ours",
        "b/ours",
    ]


def test_an_unfinished_trial_is_grouped_only_if_all_are_wanted(trial):
    cut = replace(cut_short(trial, 5), log="logs/ours/1.mcap")
    whole = replace(trial, log="logs/ours/0.mcap")
    assert describe_incompleteness(cut)
    assert not describe_incompleteness(whole)
    assert group_by_folder([whole, cut]) == {"ours": [whole]}
    assert group_by_folder([whole, cut], complete=False) == {"ours": [whole, cut]}
    with pytest.raises(LogError):
        group_by_folder([cut])


def test_errors_in_two_units_share_no_axis(trial):
    setup = replace(trial.start.setup, unit="m", metres=1.0)
    other = replace(trial, start=replace(trial.start, setup=setup))
    with pytest.raises(UsageError, match="cannot be drawn on one axis"):
        group_by_folder([trial, other])


def test_without_a_result_a_robot_ended_where_it_was_last_seen_or_at_its_start(trial):
    valid = np.ones_like(trial.valid)
    valid[-3:, 1] = False
    valid[:, 2] = False
    poses = find_final_poses(replace(trial, result=None, valid=valid))
    starts = trial.start.setup.starts.array()
    assert np.array_equal(poses, [trial.mocap[-1, 0], trial.mocap[-4, 1], starts[2]])
    assert np.array_equal(find_final_poses(trial), trial.result.verdict.final.array())


def test_many_robots_are_numbered_and_only_long_names_are_shortened():
    long = "x" * (NAME_LENGTH + 1)
    fits = "y" * NAME_LENGTH
    few = robot_labels([long, fits] + ["z"] * (NUMBERED_MIN - 3))
    assert few[:3] == ["x" * (NAME_LENGTH - 1) + "…", fits, "z"]
    assert max(map(len, few)) == NAME_LENGTH
    assert robot_labels(["z"] * NUMBERED_MIN) == [f"{i} z" for i in range(1, NUMBERED_MIN + 1)]
