"""Tests of the tables of a single log, which read its control steps as columns."""

import numpy as np
import pytest
from testkit.mutate import rewrite
from testkit.random_trials import trial, write

from tetractl.core.errors import LogError
from tetractl.log.format.channels import STEP
from tetractl.log.format.tetractl_pb2 import ControllerStep
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan
from tetractl.statistics.trial_tables import TABLES, of_log


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
    tables, damage = of_log(path, TABLES)
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
    entry = contents.by_topic[STEP][-1]
    step = ControllerStep.FromString(entry.data)
    spoil(step)
    replaced = {entry: entry._replace(data=step.SerializeToString())}
    spoilt = rewrite(contents, tmp_path / "trial.mcap", replaced)
    with pytest.raises(LogError, match="contains a value that tetractl never writes"):
        of_log(spoilt, TABLES)


def test_every_length_of_a_trial_has_its_unit_in_its_name(log, columns):
    """Regression: costs and least distances had none."""
    verdict = log.result.verdict
    for name, distances in (("clearance", verdict.clearance), ("edge", verdict.edge)):
        least = min(distances, default=np.inf)
        assert columns["trials"][f"{name}_mm"][0] == (None if least == np.inf else least)
    assert columns["trials"].keys().isdisjoint({"clearance", "edge", "apart", "total_error"})
