"""Tests of the tables of a single log, which read its control steps as columns."""

import math
from dataclasses import replace

import numpy as np
import pytest
from testkit.mutate import rewrite
from testkit.random_trials import trial, write

from tetractl.core.errors import LogError
from tetractl.log.format.channels import STEP
from tetractl.log.format.tetractl_pb2 import ControllerStep
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan
from tetractl.statistics.trial_tables import TABLES, poses, read_tables


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    two_robots = trial(steps=12, robots=2, frames=2, first=2, iterations=3, length=3)
    return write(two_robots, tmp_path_factory.mktemp("log") / "trial.mcap")


@pytest.fixture(scope="module")
def log(path):
    return read_trial(path)


@pytest.fixture(scope="module")
def columns(path):
    """The columns of each table, by the table's name."""
    tables, damage = read_tables(path, TABLES)
    assert damage is None
    return {name: table.as_dict() for name, table in tables.items()}


def test_the_table_of_steps_has_the_time_and_the_command_of_each(log, columns):
    steps = columns["steps"]
    sent_s = [log.elapsed_s(step.command.sent_ns) for step in log.steps]
    assert list(steps["k"]) == [step.k for step in log.steps]
    assert list(steps["time_s"]) == sent_s
    assert list(steps["direction_rad"]) == [step.command.direction for step in log.steps]
    second = log.start.setup.names[1]
    assert list(steps[f"delivered_{second}"]) == [step.command.delivered[1] for step in log.steps]


def test_the_table_of_steps_has_the_search_of_each(log, columns):
    steps = columns["steps"]
    plans = [step.plan for step in log.steps]
    iterations = [len(plan.search.history) - 1 for plan in plans]  # the first is the start
    sent = [getattr(step.command.action, "lag_s", None) for step in log.steps]
    stated = log.start.setup.lag_s
    assert list(steps["lag_s"]) == [stated if lag_s is None else lag_s for lag_s in sent]
    assert list(steps["iterations"]) == iterations
    assert list(steps["evaluations"]) == [plan.evaluations for plan in plans]
    assert list(steps["stopped"]) == [str(plan.search.stopped) for plan in plans]
    assert list(steps["solve_ms"]) == [step.solve_ns / 1e6 for step in log.steps]
    assert list(steps["cost_mm"]) == [plan.cost for plan in plans]


def test_the_table_of_steps_has_the_numbers_that_the_controller_says(log, columns):
    margins = [step.plan.numbers.get("margin_mm") for step in log.steps]
    assert None in margins and any(margins)  # only some steps have it
    assert list(columns["steps"]["plan_margin_mm"]) == margins


def test_the_table_of_estimates_has_a_row_for_each_robot_and_step(log, columns):
    table = columns["estimates"]
    plans = [step.plan for step in log.steps]
    estimates = [plan.estimate for plan in plans if plan.estimate is not None]
    assert estimates
    unknown = np.full(2, np.nan)
    rates = []
    biases = []
    misfits = []
    for estimate in estimates:
        rates.extend(estimate.a)
        biases.extend(unknown if estimate.heading_bias is None else estimate.heading_bias)
        misfits.extend(unknown if estimate.misfit is None else estimate.misfit.max(axis=1))
    assert table["a_rad_s"].tolist() == rates
    assert np.array_equal(table["heading_bias_rad"], biases, equal_nan=True)
    assert np.array_equal(table["misfit"], misfits, equal_nan=True)


def _deliver_to_one_robot_less(step):
    step.command.delivered.pop()


def _choose_a_search_there_is_not(step):
    step.chosen = len(step.searches)


def _estimate_one_robot_less(step):
    step.estimate.a.pop()


@pytest.mark.parametrize(
    "spoil", [_deliver_to_one_robot_less, _choose_a_search_there_is_not, _estimate_one_robot_less]
)
def test_columns_that_do_not_fit_are_one_line(path, tmp_path, spoil):
    contents = scan(path)
    entry = contents.entries_by_topic[STEP][-1]
    step = ControllerStep.FromString(entry.data)
    spoil(step)
    replaced = {entry: entry._replace(data=step.SerializeToString())}
    spoilt = rewrite(contents, tmp_path / "trial.mcap", replaced)
    with pytest.raises(LogError, match="contains a value that tetractl never writes"):
        read_tables(spoilt, TABLES)


def test_every_length_of_a_trial_has_its_unit_in_its_name(log, columns):
    """Regression: costs and least distances had none."""
    verdict = log.result.verdict
    for name, distances in (("clearance", verdict.clearance), ("edge", verdict.edge)):
        least = min(distances, default=np.inf)
        assert columns["trials"][f"{name}_mm"][0] == (None if least == np.inf else least)
    assert columns["trials"].keys().isdisjoint({"clearance", "edge", "apart", "total_error"})


def test_the_table_of_poses_has_a_row_for_each_robot_of_each_frame(log, columns):
    table = columns["poses"]
    names = log.start.setup.names
    rows = [(frame, robot) for frame in range(len(log.frames)) for robot in range(len(names))]
    assert [int(number) for number in table["frame"]] == [int(log.frames[m]) for m, _ in rows]
    assert list(table["robot"]) == [names[i] for _, i in rows]
    assert table["time_s"].tolist() == [float(log.frames_s[m]) for m, _ in rows]
    assert table["valid"].tolist() == [bool(log.valid[m, i]) for m, i in rows]
    for prefix, logged in (("", log.mocap), ("true_", log.truth)):
        for number, quantity in enumerate(("x_mm", "y_mm", "heading_rad")):
            expected = [float(logged[m, i, number]) for m, i in rows]
            assert table[f"{prefix}{quantity}"].tolist() == expected
    targets = log.start.setup.targets
    away = [math.dist(log.mocap[m, i, :2], targets[i]) for m, i in rows]
    assert table["distance_mm"] == pytest.approx(away)


def test_nobody_knows_the_true_poses_of_a_lab(log):
    table = poses(replace(log, truth=None)).as_dict()
    for quantity in ("x_mm", "y_mm", "heading_rad"):
        assert np.isnan(table[f"true_{quantity}"]).all()
        assert np.isfinite(table[quantity]).all()


def test_the_table_of_events_has_each_message_with_its_time_and_level(log, columns):
    table = columns["events"]
    assert list(table["time_s"]) == [event.time_s for event in log.events]
    assert list(table["level"]) == [event.level for event in log.events]
    assert list(table["text"]) == [event.text for event in log.events]


def test_each_table_says_of_which_log_and_trial_it_is_first_and_only_those_asked_for_are_made(path):
    tables, _ = read_tables(path, {"poses", "events"})
    assert list(tables) == ["poses", "events"]
    for table in tables.values():
        log_column, trial_column, *_ = table.columns
        assert (log_column.name, trial_column.name) == ("log", "trial")
        assert set(log_column.values) == {str(path)}
        assert set(trial_column.values) == {0}


def test_the_table_of_steps_has_when_robots_were_seen_and_what_the_plan_was(log, columns):
    steps = columns["steps"]
    plans = [step.plan for step in log.steps]
    seen_s = [log.elapsed_s(step.observation.sampled_ns) for step in log.steps]
    assert list(steps["observed_s"]) == seen_s
    assert list(steps["target_cost_mm"]) == [plan.target_cost for plan in plans]
    assert list(steps["obstacle_cost"]) == [plan.obstacle_cost for plan in plans]
    assert list(steps["signals"]) == [len(plan.signals) for plan in plans]
    assert list(steps["searches"]) == [len(plan.searches) for plan in plans]
    assert list(steps["deadline_missed"]) == [step.deadline_missed for step in log.steps]


def test_robots_on_wheels_have_the_speeds_of_both_wheels_and_others_have_no_such_columns(
    columns, tmp_path
):
    assert not [name for name in columns["steps"] if name.startswith(("left_", "right_"))]
    wheeled = trial(steps=4, robots=2, frames=2, first=1, length=2, wheels={"radius": 40})
    tables, _ = read_tables(write(wheeled, tmp_path / "wheels.mcap"), {"steps"})
    steps = tables["steps"].as_dict()
    for i, name in enumerate(("robot 0", "robot 1")):
        for side in ("left", "right"):
            logged = [getattr(step.command, side) for step in wheeled.steps]
            expected = [None if speeds is None else float(speeds[i]) for speeds in logged]
            assert list(steps[f"{side}_{name}_mm_s"]) == expected


def test_each_estimate_has_its_unit_and_a_common_dead_time_is_that_of_every_robot(log, columns):
    table = columns["estimates"]
    plans = [step.plan for step in log.steps if step.plan.estimate is not None]
    units = {"speed": "mm_s", "speed_std": "mm_s", "a_std": "rad_s", "lag": "s", "lag_std": "s"}
    for field, unit in units.items():
        expected = []
        for plan in plans:
            values = getattr(plan.estimate, field)
            expected.extend(np.full(2, np.nan) if values is None else values)
        assert np.array_equal(table[f"{field}_{unit}"], expected, equal_nan=True)
    spreads = [plan.estimate.dead_time_std for plan in plans]
    known = [np.nan if std is None else std for std in spreads]
    assert np.array_equal(table["dead_time_std_s"], np.repeat(known, 2), equal_nan=True)
    steps = [step for step in log.steps if step.plan.estimate is not None]
    assert table["k"].tolist() == [step.k for step in steps for _ in range(2)]
    sent_s = [log.elapsed_s(step.command.sent_ns) for step in steps]
    assert table["time_s"].tolist() == [time_s for time_s in sent_s for _ in range(2)]
    assert list(table["robot"]) == [*log.start.setup.names] * len(steps)
