"""What a report holds of its trials, and the figures of its batches."""

import json
import re
import zlib
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import random_trials as made
from support.trials import three_robots

from tetractl.core.commands import Stop
from tetractl.core.plan import Outcome, State
from tetractl.log.read.reader import read_result, read_trial
from tetractl.report.page import carried, lean, of_batch
from tetractl.report.trial_data import packed, significant, trial_data
from tetractl.results.describe import describe
from tetractl.results.open_batch import Batch
from tetractl.view.figures.draw import draw
from tetractl.view.style import svg


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    trials = [made.trial(seed, steps=3, index=seed) for seed in range(3)]
    return [read_trial(made.write(one, folder / f"{i}.mcap")) for i, one in enumerate(trials)]


def pictures(html):
    return [b64decode(data) for data in re.findall(r"base64,([^\"]+)", html)]


@pytest.mark.long
@pytest.mark.slow  # draws
def test_a_batch_is_drawn_as_plot_draws_it_though_little_of_it_is_kept(logs):
    shown = of_batch("one & two", [lean(log) for log in logs])
    assert pictures(shown) == [svg(draw("errors", logs))]
    assert shown.count(": one &amp; two<") == 1
    assert of_batch("", logs[:1]) == ""


def test_the_page_has_each_pose_plan_and_search(tmp_path):
    log = read_trial(made.write(made.trial(3, steps=4), tmp_path / "t.mcap"))
    setup = log.start.setup
    size = max(setup.arena.width, setup.arena.height)
    data = json.loads(zlib.decompress(b64decode(packed(trial_data(log, "t")))))
    shown = [[np.nan if x is None else x for x in pose] for pose in data["frames"]["xy"][-1]]
    seen = np.where(log.valid[-1, :, None], log.mocap[-1, :, :2], np.nan)
    assert np.asarray(shown, dtype=float) == pytest.approx(seen, abs=1e-6 * size, nan_ok=True)
    for step, plan, history in zip(log.steps, data["plan"], data["history"], strict=True):
        assert np.array(plan) == pytest.approx(step.plan.path[..., :2], abs=1e-3 * size)
        assert history == pytest.approx(step.plan.search.history, rel=1e-3)
    assert trial_data(log, "t", plans=False)["plan"] is None


def test_the_player_ends_with_the_result_and_says_whether_it_is_measured():
    log = three_robots()
    shown = trial_data(log, "t")
    assert shown["final"]["errors"] == pytest.approx(log.result.robot_errors, abs=1e-3)
    assert shown["final"]["known"] == "true"
    assert shown["frames"]["t"][-1] <= shown["end"]
    lab = replace(log.start, plant=replace(log.start.plant, simulated=False))
    assert trial_data(replace(log, start=lab), "t")["final"]["known"] == "measured"


def test_robots_that_stand_follow_no_plan():
    log = three_robots()
    plan = replace(log.steps[3].plan, instead=Stop(), state=State.RESTING)
    command = replace(log.steps[3].command, action=Stop())
    steps = (*log.steps[:3], replace(log.steps[3], plan=plan, command=command), *log.steps[4:])
    log = replace(log, steps=steps)
    shown = trial_data(log, "t")["steps"]
    told = [shown[name][3] for name in ("u", "doing", "cost", "signals", "ended")]
    assert told == [None, "standing", None, None, "–"]


def test_a_page_of_many_trials_carries_some_from_the_best_to_the_worst(logs, monkeypatch):
    result = read_result(Path(logs[0].log))
    trials = [
        replace(
            result,
            log=f"t/{i}.mcap",
            trial=i,
            result=replace(result.result, total_error=float(i * 37 % 101), outcome=outcome),
        )
        for i in range(101)
        for outcome in [Outcome.ABORTED if i % 50 == 7 else Outcome.ARRIVED]
    ]
    group = describe(Batch.of(trials))
    kept = carried(group, 2)
    assert len(kept) == 30 and kept == sorted(kept, key=lambda path: int(path.stem))
    errors = {Path(t.log): t.result.total_error for t in trials if t.outcome.complete}
    seen = sorted(errors[path] for path in kept if path in errors)
    assert len(seen) == 28  # and both that were aborted
    assert (seen[0], seen[-1]) == (min(errors.values()), max(errors.values()))
    assert max(np.diff(seen)) <= 6
    assert len(carried(group, 1000)) == 3


def test_what_is_not_finite_is_missing():
    assert significant([1234.56, -1e-7, np.nan, np.inf]) == [1235.0, -1e-7, None, None]
