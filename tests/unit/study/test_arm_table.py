"""Tests of the tables and figures of a study: errors by arm and by each swept field."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from testkit.studies import STUDY, run

from tetractl.core.plan import Outcome
from tetractl.statistics.estimate import distributions
from tetractl.statistics.flagged import SAFETY
from tetractl.study import arm_table, figure
from tetractl.study.arm_table import arms_table, group_by_value, group_errors, write_table
from tetractl.study.figure import study_figure, write_figures
from tetractl.study.load_study import arm_name

TRIALS = 5  # of each of the eight arms of STUDY


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    return run(tmp_path_factory.mktemp("study"), STUDY)


def errors(ran, arm):
    return [ran.finished[arm.name, trial].result.total_error for trial in range(TRIALS)]


def distribution_of(values):
    (distribution,) = distributions(np.array([values]))
    return distribution


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def headline_of(figure):
    (text,) = figure.texts
    return text.get_text()


@pytest.mark.long
def test_the_error_of_one_arm_is_that_of_its_trials(ran):
    arm = ran.loaded.arms[2]
    group = group_errors(ran.store, arm.name, [arm])
    assert group.errors.tolist() == errors(ran, arm)
    assert group.error == distribution_of(errors(ran, arm))


def test_over_several_arms_trials_of_one_seed_count_once(ran):
    few = [arm for arm in ran.loaded.arms if arm.controller == "few"]
    at_0, at_tenth = group_by_value(ran.store, "plant.dead_time", few)
    assert at_0.value == 0
    assert at_tenth.value == 0.1
    for group in (at_0, at_tenth):
        assert group.arms == 2
        assert group.error.n == TRIALS
    arms_at_0 = [arm for arm in few if arm.values["plant.dead_time"] == 0]
    means_of_trials = np.mean([errors(ran, arm) for arm in arms_at_0], axis=0)
    assert at_0.error == distribution_of(means_of_trials)


def test_the_table_has_one_tidy_row_a_trial(ran):
    trials = write_table(ran.loaded, ran.store)
    rows = rows_of(trials)
    assert [(row["arm"], int(row["trial"])) for row in rows] == list(ran.finished)
    columns = list(rows[0])
    assert columns[:4] == ["log", "trial", "arm", "controller"]
    assert columns[4:6] == ["plant.dead_time", "robots.r.a"]
    assert columns[-2:] == ["content_digest", "code"]
    assert "deadline_misses" not in columns  # the same on every machine


def test_the_errors_of_arms_are_a_table(ran):
    table = arms_table(ran.loaded, ran.store)
    assert table.header[:3] == ["arm", "n", "mean"]
    assert table.header[-2:] == ["aborted", "plant"]
    assert [row[0] for row in table.rows] == [arm.name for arm in ran.loaded.arms]
    first_arm = ran.loaded.arms[0]
    means = table.columns[2].values
    assert means[0] == pytest.approx(np.mean(errors(ran, first_arm)))
    assert table.note == "disturbances are assumed in the spec, not measured"


def test_the_table_counts_what_must_not_happen(ran, monkeypatch):
    """Regression: arms that entered the obstacle in 10 of 10 trials looked like the others."""
    first, second, *_ = ran.loaded.arms
    assert not {*SAFETY} & {*arms_table(ran.loaded, ran.store).header}
    for arm, number, changes in [
        (first, 0, {"entered": (True,)}),
        (first, 3, {"entered": (True,), "edge": (-1.0,)}),
        (second, 1, {"edge": (-1.0,)}),
    ]:
        results = ran.store.batches[arm.name].results
        result = results[number].result
        unsafe = replace(result, verdict=replace(result.verdict, **changes))
        monkeypatch.setitem(results, number, replace(results[number], result=unsafe))
    table = arms_table(ran.loaded, ran.store)
    columns = {column.name: column.values for column in table.columns}
    others = [0] * (len(ran.loaded.arms) - 2)
    assert columns["entered an obstacle"] == [2, 0, *others]
    assert columns["left the arena"] == [1, 1, *others]
    assert "touched one another" not in columns
    assert table.header.index("left the arena") < table.header.index("95 % interval")


def test_of_many_arms_the_first_are_listed_and_the_rest_are_counted(ran, monkeypatch):
    whole = arms_table(ran.loaded, ran.store)
    monkeypatch.setattr(arm_table, "ARMS_LISTED_MAX", 8)
    assert arms_table(ran.loaded, ran.store).note == whole.note
    monkeypatch.setattr(arm_table, "ARMS_LISTED_MAX", 3)
    table = arms_table(ran.loaded, ran.store)
    assert [row[0] for row in table.rows] == [row[0] for row in whole.rows][:3]
    assert table.note.endswith("; and 5 more arms, listed in the table of trials")


def test_aborted_trials_are_counted_in_their_arm(ran, monkeypatch):
    arm = ran.loaded.arms[1]
    results = ran.store.batches[arm.name].results
    for number in (1, 4):
        aborted = replace(results[number].result, outcome=Outcome.ABORTED)
        monkeypatch.setitem(results, number, replace(results[number], result=aborted))
    table = arms_table(ran.loaded, ran.store)
    columns = {column.name: column.values for column in table.columns}
    assert columns["aborted"] == [0, 2, 0, 0, 0, 0, 0, 0]


def test_only_trials_that_all_arms_of_a_group_have_count(ran, monkeypatch):
    first, second = ran.loaded.arms[:2]
    expected = np.delete(np.mean([errors(ran, first), errors(ran, second)], axis=0), 2)
    monkeypatch.delitem(ran.store.batches[second.name].results, 2)
    group = group_errors(ran.store, 1, [first, second])
    assert group.errors == pytest.approx(expected)
    assert group.arms == 2


@pytest.mark.long
def test_there_is_a_figure_for_each_field_and_it_repeats(ran):
    paths = write_figures(ran.loaded, ran.store)
    assert [path.name for path in paths] == [
        "error-arms.png",
        "error-plant.dead_time.png",
        "error-robots.r.a.png",
    ]
    before = [path.read_bytes() for path in paths]
    again = write_figures(ran.loaded, ran.store)
    assert [path.read_bytes() for path in again] == before


def test_figures_are_named_after_their_fields_and_none_is_empty(ran, monkeypatch):
    drawn = []

    def draw(loaded, store, field=""):
        drawn.append(field)
        return None if field == "robots.r.a" else object()

    monkeypatch.setattr(figure, "study_figure", draw)
    monkeypatch.setattr(figure.style, "save", lambda drawing, path: None)
    paths = write_figures(ran.loaded, ran.store)
    assert drawn == ["", "plant.dead_time", "robots.r.a"]
    assert [path.name for path in paths] == ["error-arms.png", "error-plant.dead_time.png"]
    assert {path.parent for path in paths} == {ran.store.folder}


def test_a_figure_has_a_line_for_each_controller(ran):
    figure = study_figure(ran.loaded, ran.store, "plant.dead_time")
    many, few = [line for line in figure.axes[0].get_lines() if line.get_gid() != "trials"]
    assert many.get_label() == "many"
    assert few.get_label() == "few"
    assert list(many.get_xdata()) == [0, 0.1]
    assert list(few.get_xdata()) == [0, 0.1]
    assert headline_of(figure) == (
        "quick, disturbed simulation: mean over the other fields and its 95 % interval,"
        " n = 5 trials, each a dot"
    )


@pytest.mark.long
def test_a_study_without_a_sweep_has_a_figure_of_its_arms(tmp_path):
    study = (
        "name: q\nbase: spec.yaml\ntrials: {count: 5}\n"
        "controllers:\n  ours: {controller.period: 0.1}\n  theirs: {controller.period: 0.2}\n"
    )
    ran = run(tmp_path, study)
    (path,) = write_figures(ran.loaded, ran.store)
    assert path.name == "error-arms.png"
    (axes,) = study_figure(ran.loaded, ran.store).axes
    assert [label.get_text() for label in axes.get_xticklabels()] == ["ours", "theirs"]
    mean_ours, mean_theirs = [
        list(line.get_ydata()) for line in axes.get_lines() if line.get_gid() != "trials"
    ]
    ours, theirs = ran.loaded.arms
    assert mean_ours == pytest.approx([np.mean(errors(ran, ours))])
    assert mean_theirs == pytest.approx([np.mean(errors(ran, theirs))])
    dots = [y for line in axes.get_lines() if line.get_gid() == "trials" for y in line.get_ydata()]
    assert sorted(dots) == sorted(errors(ran, ours) + errors(ran, theirs))


@pytest.mark.parametrize(
    ("controller", "values", "name"),
    [
        (
            "ours",
            {"plant.dead_time": 0.07, "plant.a_error": 0.1},
            "ours-dead_time=0.07-a_error=0.1",
        ),
        ("", {"robots.r.a": 1, "robots.g.a": 2}, "robots.r.a=1-robots.g.a=2"),
        ("", {"controller": {"type": "pso-mpc"}}, "controller=_type_pso-mpc_"),
        ("two words", {}, "two_words"),
        ("", {}, "base"),
    ],
)
def test_arms_have_names_that_fit_a_file_system(controller, values, name):
    assert arm_name(controller, values) == name
