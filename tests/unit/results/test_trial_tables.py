"""The tables of one log, whose control steps are read as columns."""

import numpy as np
import pytest
from support.mutate import rewrite
from support.random_trials import trial, write

from tetractl.core.errors import LogError
from tetractl.log.format import codec
from tetractl.log.format.channels import STEP
from tetractl.log.format.tetractl_pb2 import ControllerStep
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan
from tetractl.results.trial_tables import TABLES, of_log


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    made = trial(steps=12, robots=2, frames=2, first=2, iterations=3, length=3)
    return write(made, tmp_path_factory.mktemp("log") / "trial.mcap")


def test_the_columns_are_those_of_the_decoded_steps(path):
    log = read_trial(path)
    found, damage = of_log(path, TABLES)
    assert damage is None
    columns, plans = found["steps"].as_dict(), [step.plan for step in log.steps]
    assert list(columns["k"]) == [step.k for step in log.steps]
    assert list(columns["time_s"]) == [log.elapsed_s(one.command.sent_ns) for one in log.steps]
    assert list(columns["direction_rad"]) == [step.command.direction for step in log.steps]
    assert list(columns["lag_s"]) == [log.start.setup.lag_s] * len(log.steps)
    assert list(columns["iterations"]) == [len(plan.search.history) - 1 for plan in plans]
    assert list(columns["evaluations"]) == [plan.evaluations for plan in plans]
    assert list(columns["stopped"]) == [str(plan.search.stopped) for plan in plans]
    assert list(columns["solve_ms"]) == [step.solve_ns / 1e6 for step in log.steps]
    assert list(columns["cost_mm"]) == [plan.cost for plan in plans]
    name = log.start.setup.names[1]
    assert list(columns[f"delivered_{name}"]) == [step.command.delivered[1] for step in log.steps]
    known = [step.plan.estimate for step in log.steps if step.plan.estimate is not None]
    of = found["estimates"].as_dict()
    assert known
    assert of["a_rad_s"].tolist() == np.ravel([one.a for one in known]).tolist()
    bias = [np.full(2, np.nan) if one.heading_bias is None else one.heading_bias for one in known]
    assert np.array_equal(of["heading_bias_rad"], np.ravel(bias), equal_nan=True)
    misfit = [[np.nan] * 2 if one.misfit is None else one.misfit.max(axis=1) for one in known]
    assert np.array_equal(of["misfit"], np.ravel(misfit), equal_nan=True)


def test_every_length_of_a_trial_has_its_unit_in_its_name(path):
    """Regression: costs and least distances had none."""
    log = read_trial(path)
    columns = of_log(path, ["trials"])[0]["trials"].as_dict()
    verdict = log.result.verdict
    for key, each in (("clearance", verdict.clearance), ("edge", verdict.edge)):
        least = min(each, default=np.inf)
        assert columns[f"{key}_mm"][0] == (None if least == np.inf else least)
    assert columns.keys().isdisjoint({"clearance", "edge", "apart", "total_error"})


def test_a_plan_is_not_decoded_to_be_exported(path, monkeypatch):
    decoded = []
    decode = codec.decode_step
    monkeypatch.setattr(codec, "decode_step", lambda *a: decoded.append(a) or decode(*a))
    of_log(path, TABLES)
    assert len(decoded) == 1


def _unsaid(step):
    step.command.delivered.pop()


def _elsewhere(step):
    step.chosen = len(step.searches)


def _narrow(step):
    step.estimate.a.pop()


@pytest.mark.parametrize("spoil", [_unsaid, _elsewhere, _narrow])
def test_columns_that_do_not_fit_are_one_line(path, tmp_path, spoil):
    contents = scan(path)
    entry = contents.by_topic[STEP][-1]
    step = ControllerStep.FromString(entry.data)
    spoil(step)
    new = {entry: entry._replace(data=step.SerializeToString())}
    with pytest.raises(LogError, match="contains a value that tetractl does not write"):
        of_log(rewrite(contents, tmp_path / "trial.mcap", new), TABLES)
