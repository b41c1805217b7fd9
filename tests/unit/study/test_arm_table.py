import csv
from dataclasses import replace

import numpy as np
import pytest
from support.studies import FAILING, STUDY, run

from tetractl.results.estimate import distributions
from tetractl.study.arm_table import arms_table, field_values, group_of, write_tables
from tetractl.study.figure import error_figure, write_figures
from tetractl.study.load_study import arm_name
from tetractl.study.options import Logs


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    return run(tmp_path_factory.mktemp("study"), STUDY)


def errors(ran, arm):
    return [ran.finished[arm.name, trial].result.total_error for trial in range(5)]


def test_the_error_of_one_arm_is_that_of_its_trials(ran):
    arm = ran.loaded.arms[2]
    found = group_of(ran.loaded, ran.store, arm.name, [arm])
    assert found.errors.tolist() == errors(ran, arm)
    assert found.error == distributions(np.array([errors(ran, arm)]))[0]


def test_over_several_arms_trials_of_one_seed_count_once(ran):
    few = [arm for arm in ran.loaded.arms if arm.controller == "few"]
    found = field_values(ran.loaded, ran.store, "plant.dead_time", few)
    assert [(group.value, group.arms, group.error.n) for group in found] == [(0, 2, 5), (0.1, 2, 5)]
    mean = np.mean([errors(ran, arm) for arm in few if arm.values["plant.dead_time"] == 0], axis=0)
    assert found[0].error == distributions(mean[None])[0]


def test_a_trial_that_aborted_does_not_count(tmp_path):
    ran = run(tmp_path, FAILING)
    found = field_values(ran.loaded, ran.store, "robots.r.speed", ran.loaded.arms)
    assert [(group.value, group.error.n) for group in found] == [(200, 4), (1e308, 0)]


def test_the_table_has_one_tidy_row_a_trial(ran):
    paths = write_tables(ran.loaded, ran.store)
    with paths[0].open(newline="") as file:
        found = list(csv.DictReader(file))
    assert [(row["arm"], int(row["trial"])) for row in found] == list(ran.finished)
    assert list(found[0])[:6] == [
        "log",
        "trial",
        "arm",
        "controller",
        "plant.dead_time",
        "robots.r.a",
    ]
    assert list(found[0])[-2:] == ["content_digest", "code"]
    assert "deadline_misses" not in found[0]
    with paths[1].open(newline="") as file:
        times = list(csv.DictReader(file))
    assert float(times[0]["solve_max_ms"]) >= float(times[0]["solve_mean_ms"]) > 0
    assert len(times) == 40


def test_the_errors_of_arms_are_a_table(ran):
    found = arms_table(ran.loaded, ran.store)
    assert found.header[:3] == ["arm", "n", "mean"]
    assert found.header[-2:] == ["aborted", "plant"]
    assert [row[0] for row in found.rows] == [arm.name for arm in ran.loaded.arms]
    assert found.columns[2].values[0] == pytest.approx(np.mean(errors(ran, ran.loaded.arms[0])))
    assert found.note == "disturbances are assumed in the spec, not measured"


def test_rows_of_several_types_of_processor_are_marked(ran):
    arm = ran.loaded.arms[0].name
    own = ran.store.batches[arm].results[0]
    ran.store.batches[arm].results[0] = replace(own, processor="other-123456")
    try:
        assert arms_table(ran.loaded, ran.store).note.startswith(
            "trials of 2 types of processor, on which the same seed may give another trial: "
            f"{own.processor} (39), other-123456 (1); "
        )
    finally:
        ran.store.batches[arm].results[0] = own


def test_there_is_a_figure_for_each_field_with_a_line_for_each_controller(ran):
    paths = write_figures(ran.loaded, ran.store)
    assert [path.name for path in paths] == [
        "error-arms.png", "error-plant.dead_time.png", "error-robots.r.a.png"
    ]  # fmt: skip
    before = [path.read_bytes() for path in paths]
    assert [path.read_bytes() for path in write_figures(ran.loaded, ran.store)] == before
    figure = error_figure(ran.loaded, ran.store, "plant.dead_time")
    lines = [line for line in figure.axes[0].get_lines() if line.get_gid() != "trials"]
    assert [line.get_label() for line in lines] == ["many", "few"]
    assert [list(line.get_xdata()) for line in lines] == [[0, 0.1]] * 2
    (headline,) = (text.get_text() for text in figure.texts)
    assert headline == (
        "quick, disturbed simulation: mean over the other fields and its 95 % interval,"
        " n = 5 trials, each a dot"
    )


def test_a_study_without_a_sweep_has_a_figure_of_its_arms(tmp_path):
    study = (
        "name: q\nbase: spec.yaml\ntrials: {count: 5}\n"
        "controllers:\n  ours: {controller.period: 0.1}\n  theirs: {controller.period: 0.2}\n"
    )
    ran = run(tmp_path, study)
    assert [path.name for path in write_figures(ran.loaded, ran.store)] == ["error-arms.png"]
    (axes,) = error_figure(ran.loaded, ran.store, "arms").axes
    assert [label.get_text() for label in axes.get_xticklabels()] == ["ours", "theirs"]
    found = [list(line.get_ydata()) for line in axes.get_lines()]
    means = [mean for (mean,) in found[::2]]
    assert means == pytest.approx([np.mean(errors(ran, arm)) for arm in ran.loaded.arms])
    assert found[1::2] == [errors(ran, arm) for arm in ran.loaded.arms]


def test_arms_without_a_controller_are_called_given_directions(tmp_path):
    study = (
        "name: q\nbase: spec.yaml\ntrials: {count: 1}\n"
        "controllers:\n  ours: {}\n"
        "  found: {controller: {type: sequence, directions: [0.1, 0.1]}}\n"
    )
    ran = run(tmp_path, study)
    assert "given directions: found" in arms_table(ran.loaded, ran.store).note
    (headline,) = (text.get_text() for text in error_figure(ran.loaded, ran.store, "arms").texts)
    assert headline.endswith("; given directions: found")


def test_arms_have_level_names_if_there_is_room(ran):
    few = replace(ran.loaded, arms=ran.loaded.arms[:3])
    for loaded, first, turned in (
        (few, "many\ndead_time=0\na=3", 0),
        (replace(few, arms=few.arms * 9), "many-dead_time=0-a=3", 90),
    ):
        (axes,) = error_figure(loaded, ran.store, "arms").axes
        label = axes.get_xticklabels()[0]
        assert (label.get_text(), label.get_rotation()) == (first, turned)


def test_values_that_are_no_numbers_have_places_in_their_order(tmp_path):
    study = (
        "name: q\nbase: spec.yaml\ntrials: {count: 3}\n"
        "sweep:\n  type: list\n"
        "  points: [{plant.motion: euler}, {plant.motion: arc}, {plant.dead_time: 0.1}]\n"
    )
    ran = run(tmp_path, study)
    axes = error_figure(ran.loaded, ran.store, "plant.motion").axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["euler", "arc"]
    cells = [ran.loaded.arms[2].values.get("plant.motion"), ran.loaded.paths]
    assert cells == [None, ("plant.motion", "plant.dead_time")]


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


def test_options_are_parsed():
    assert Logs.parse("sample:3") == Logs(3, False)
    assert Logs.parse("all").each == float("inf")
    assert (Logs.parse("failed"), Logs.parse("none")) == (Logs(0, True), Logs(0, False))
