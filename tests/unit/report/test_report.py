"""Tests of a report's trials, and of the figures of its batches."""

import json
import re
import zlib
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from testkit import random_trials
from testkit.trials import in_lab, three_robots

from tetractl.core.commands import Stop
from tetractl.core.plan import Outcome, State
from tetractl.log.read.reader import read_result, read_trial
from tetractl.report.page import errors_over_time, logs_to_carry, without_details
from tetractl.report.trial_data import pack_trial, round_significant, trial_data
from tetractl.statistics.describe import describe
from tetractl.statistics.open_batch import Batch
from tetractl.view.figures.draw import draw
from tetractl.view.style import svg


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Three random trials."""
    folder = tmp_path_factory.mktemp("logs")
    read_logs = []
    for seed in range(3):
        trial = random_trials.trial(seed, steps=3, index=seed)
        path = random_trials.write(trial, folder / f"{seed}.mcap")
        read_logs.append(read_trial(path))
    return read_logs


def pictures(html):
    return [b64decode(data) for data in re.findall(r"base64,([^\"]+)", html)]


@pytest.mark.long
@pytest.mark.slow  # draws
def test_a_batch_is_drawn_as_plot_draws_it_though_little_of_it_is_kept(logs):
    html = errors_over_time("one & two", [without_details(log) for log in logs])
    assert pictures(html) == [svg(draw("errors", logs))]
    assert html.count(": one &amp; two<") == 1


def unpacked(text):
    """What the page's script reads from the data packed into it."""
    return json.loads(zlib.decompress(b64decode(text)))


@pytest.fixture
def log(tmp_path):
    """Of four control steps."""
    trial = random_trials.trial(3, steps=4)
    return random_trials.write_and_read(trial, tmp_path / "t.mcap")


def arena_size(log):
    arena = log.start.setup.arena
    return max(arena.width, arena.height)


def test_the_page_has_the_poses_that_were_measured(log):
    data = unpacked(pack_trial(trial_data(log, "t")))
    last = np.array(data["frames"]["xy"][-1], dtype=float)  # None becomes NaN
    measured = np.where(log.valid[-1, :, None], log.mocap[-1, :, :2], np.nan)
    assert last == pytest.approx(measured, abs=1e-6 * arena_size(log), nan_ok=True)


def test_the_page_has_each_plan_and_search(log):
    data = unpacked(pack_trial(trial_data(log, "t")))
    for step, path, history in zip(log.steps, data["plan"], data["history"], strict=True):
        assert np.array(path) == pytest.approx(step.plan.path[..., :2], abs=1e-3 * arena_size(log))
        assert history == pytest.approx(step.plan.search.history, rel=1e-3)


def with_robots_at_rest(step):
    plan = replace(step.plan, instead=Stop(), state=State.RESTING)
    return replace(step, plan=plan, command=replace(step.command, action=Stop()))


def test_robots_that_stand_follow_no_plan():
    log = three_robots()
    steps = list(log.steps)
    steps[3] = with_robots_at_rest(steps[3])
    columns = trial_data(replace(log, steps=tuple(steps)), "t")["steps"]
    assert columns["doing"][3] == "standing"
    assert columns["u"][3] is None
    assert columns["cost"][3] is None
    assert columns["signals"][3] is None
    assert columns["ended"][3] == "–"


@pytest.fixture
def batch_of_101(logs):
    """Trials with the errors 0 to 100, in a mixed order, of which 7 and 57 were aborted."""
    trial = read_result(Path(logs[0].log))
    trials = []
    for i in range(101):
        error = float(i * 37 % 101)
        outcome = Outcome.ABORTED if i in (7, 57) else Outcome.ARRIVED
        result = replace(trial.result, total_error=error, outcome=outcome)
        trials.append(replace(trial, log=f"t/{i}.mcap", trial=i, result=result))
    return describe(Batch.from_results(trials))


def test_a_page_of_many_trials_carries_some_from_the_best_to_the_worst(batch_of_101):
    carried_logs = logs_to_carry(batch_of_101, 2)
    assert len(carried_logs) == 30
    assert carried_logs == sorted(carried_logs, key=lambda path: int(path.stem))
    complete = [trial for trial in batch_of_101.batch.trials if trial.outcome.complete]
    errors = {Path(trial.log): trial.result.total_error for trial in complete}
    carried_errors = sorted(errors[path] for path in carried_logs if path in errors)
    assert len(carried_errors) == 30 - 2  # both that were aborted are carried too
    assert carried_errors[0] == min(errors.values())
    assert carried_errors[-1] == max(errors.values())
    assert max(np.diff(carried_errors)) <= 6


def test_a_page_of_very_many_batches_carries_three_trials_of_each(batch_of_101):
    assert len(logs_to_carry(batch_of_101, 1000)) == 3


def test_one_trial_has_no_figure_of_a_batch(logs):
    assert errors_over_time("", logs[:1]) == ""


def test_the_page_may_leave_out_plans(log):
    assert trial_data(log, "t", plans=False)["plan"] is None


def test_the_result_of_a_lab_is_said_to_be_measured():
    assert trial_data(in_lab(three_robots()), "t")["final"]["known"] == "measured"


def test_what_is_not_finite_is_missing():
    assert round_significant([1234.56, -1e-7, np.nan, np.inf]) == [1235.0, -1e-7, None, None]
