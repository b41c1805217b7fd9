"""Tests of which parts a report has, for one batch and for several, and what it leaves out."""

import json
import re
from dataclasses import replace

import pytest
from testkit import random_trials
from testkit.batches import batch, experiment, group
from testkit.batches import result as made_result
from testkit.batches import trial as made_trial
from testkit.random_trials import SMALL

from tetractl.core.errors import LogError
from tetractl.core.plan import Outcome
from tetractl.log.read.reader import read_trial
from tetractl.report import page
from tetractl.report.page import (
    errors_over_time,
    figures_of_trial,
    logs_to_carry,
    player,
    report,
    total_errors,
    without_details,
)


@pytest.fixture
def without_drawing(monkeypatch):
    """Stand for figures by their captions: drawing takes longer than everything else."""
    monkeypatch.setattr(
        page, "_figure_html", lambda kind, logs, text: f"<figure>{kind}: {text}</figure>"
    )
    monkeypatch.setattr(page, "total_errors", lambda groups, numbers: "<svg></svg>")


def logs_in(folder, count, name="made-up", **fields):
    folder.mkdir(parents=True)
    for index in range(count):
        made = random_trials.trial(index, steps=3, index=index, name=name, **SMALL | fields)
        random_trials.write(made, folder / f"trial-{index:03d}.mcap")
    return folder


def made(paths, title=None):
    """A report, its faults and the progress that it reported."""
    told = []
    html, faults = report(paths, title, lambda done, count: told.append((done, count)))
    return html, faults, told


def headings(html):
    return re.findall(r"<h2>([^<]*)</h2>", html)


def options(html):
    """The trials that can be chosen."""
    return re.findall(r"<option value=\"\d+\">(\d+: [^<]*)</option>", html)


def statistics_of(html):
    (data,) = re.findall(r'class="statistics">(.*?)</script>', html, re.DOTALL)
    return json.loads(data)


def test_the_report_of_a_batch_plays_its_trials_and_has_its_statistics(tmp_path, without_drawing):
    html, faults, told = made([logs_in(tmp_path / "a", 3)])
    assert faults == []
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert "<h1>made-up</h1>" in html
    assert options(html) == [f"{i + 1}: trial-00{i}.mcap" for i in range(3)]
    parts = ["Errors", "Statistics", "Figures of the first trial", "Provenance"]
    assert [part for part in headings(html) if part in parts] == parts
    assert "Comparison" not in headings(html)
    assert statistics_of(html)["n_trials"] == 3
    assert html.count('id="trial-data-') == 3


def test_a_report_of_one_trial_has_no_errors_of_several(tmp_path, without_drawing):
    html, _, _ = made([logs_in(tmp_path / "a", 1) / "trial-000.mcap"])
    assert "Errors" not in headings(html)
    assert options(html) == ["1: trial-000.mcap"]


def test_the_arms_of_a_study_are_compared_and_the_page_is_called_by_its_folder(
    tmp_path, without_drawing
):
    study = tmp_path / "slip"
    logs_in(study / "arm=0", 2)
    logs_in(study / "arm=1", 2, controller={"time_limit": 9})
    html, faults, _ = made([study])
    assert faults == []
    assert "<h1>slip</h1>" in html
    assert {"Statistics: arm=0", "Statistics: arm=1", "Comparison"} <= set(headings(html))
    assert options(html)[2] == "3: arm=1, trial-000.mcap"
    assert html.count("errors: The error of each trial over time") == 2
    assert len(statistics_of(html)["groups"]) == 2


def test_batches_of_several_experiments_name_them_all_unless_there_is_a_title(
    tmp_path, without_drawing
):
    folders = [logs_in(tmp_path / name, 2, name=name) for name in ("one", "two")]
    assert "<h1>one, two</h1>" in made(folders)[0]
    assert "<h1>a &amp; b</h1>" in made(folders, title="a & b")[0]
    html, _, _ = made([folders[0], folders[1] / "trial-000.mcap"])
    assert len(statistics_of(html)["groups"]) == 2  # single logs are one more batch


def test_logs_that_cannot_be_read_or_are_damaged_are_faults(tmp_path, without_drawing):
    folder = logs_in(tmp_path / "a", 3)
    torn = folder / "trial-001.mcap"
    torn.write_bytes(torn.read_bytes()[:-400])
    (folder / "trial-007.mcap").write_bytes(b"no log")
    html, faults, _ = made([folder])
    assert faults == [
        f"{folder / 'trial-007.mcap'}: this is not an MCAP file",
        f"{torn}: damaged, read as far as possible",
    ]
    assert len(options(html)) == 3


def test_without_any_log_that_can_be_read_there_is_no_report(tmp_path, without_drawing):
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / "trial-000.mcap").write_bytes(b"no log")
    with pytest.raises(LogError, match=r"none of the logs can be read: .*trial-000\.mcap: "):
        made([folder])


@pytest.mark.parametrize(("many", "complete"), [(3, True), (2, False)])
def test_a_report_of_many_trials_leaves_out_plans_and_says_so(
    tmp_path, monkeypatch, without_drawing, many, complete
):
    monkeypatch.setattr(page, "COMPLETE_TRIALS_MAX", many)
    plans = []
    real = page.trial_data

    def data(log, file, with_plans=True):
        plans.append(with_plans)
        return real(log, file, with_plans)

    monkeypatch.setattr(page, "trial_data", data)
    html, _, _ = made([logs_in(tmp_path / "a", 3)])
    assert plans == [complete] * 3
    assert (page.SELECTION_NOTE.format(3, 3) in html) != complete
    assert ("the 3 trials on this page" in html) != complete


@pytest.mark.parametrize(("many", "complete"), [(2, True), (1, False)])
def test_a_player_of_many_trials_leaves_out_plans_too(tmp_path, monkeypatch, many, complete):
    monkeypatch.setattr(page, "COMPLETE_TRIALS_MAX", many)
    folder = logs_in(tmp_path / "a", 2)
    logs = [read_trial(path) for path in sorted(folder.iterdir())]
    plans = []
    monkeypatch.setattr(page, "trial_data", lambda log, name, with_: plans.append(with_) or {})
    html = player(logs).page
    assert plans == [complete] * 2
    assert options(html) == ["1: trial-000.mcap", "2: trial-001.mcap"]


# ---- Parts ----


def totals(count, **fields):
    """A batch of trials with the errors 0, 1, 2 and so on, of which the last ones do not count."""
    spec = experiment(1)
    return [
        made_trial(f"t/{i}.mcap", spec, made_result([float(i)], **fields), i) for i in range(count)
    ]


def test_a_batch_that_fits_is_carried_whole_and_in_order():
    described = group(totals(30))
    assert [path.stem for path in logs_to_carry(described, 2)] == [str(i) for i in range(30)]
    carried = logs_to_carry(group(totals(31)), 2)
    assert len(carried) == 30
    assert {"0", "30"} <= {path.stem for path in carried}


def test_what_does_not_count_takes_a_part_of_the_places_only():
    trials = totals(100)
    aborted = [
        replace(t, result=replace(t.result, outcome=Outcome.ABORTED)) if t.trial < 60 else t
        for t in trials
    ]
    carried = [int(path.stem) for path in logs_to_carry(group(aborted), 2)]
    most = max(page.CARRIED_PER_BATCH_MIN, page.CARRIED_TRIALS_MAX // 2)
    assert sum(number < 60 for number in carried) == most // page.EXCLUDED_RATIO
    assert len(carried) == most
    assert {60, 99} <= set(carried)


@pytest.mark.parametrize("radius", [0, 47])
def test_the_overview_says_whether_bodies_or_centres_were_checked(
    tmp_path, monkeypatch, without_drawing, radius
):
    fields = {"controller": {"type": "mpc", "collision": {"radius": radius}}} if radius else {}
    html, _, _ = made([logs_in(tmp_path / "a", 2, **fields, obstacles=[])])
    checked = "bodies of radius 47 mm" if radius else "centres"
    assert f"what was checked: a: undisturbed simulation, {checked}." in html


def test_a_trial_without_steps_or_without_frames_has_no_figures(tmp_path, without_drawing):
    log = read_trial(logs_in(tmp_path / "a", 1) / "trial-000.mcap")
    assert figures_of_trial(log).count("<figure>") == len(page.TRIAL_FIGURES)
    assert figures_of_trial(replace(log, steps=())) == ""
    assert figures_of_trial(replace(log, mocap_ns=log.mocap_ns[:0])) == ""
    assert errors_over_time("a", [log]) == ""
    assert errors_over_time("a", [log, replace(log, mocap_ns=log.mocap_ns[:0])]) == ""
    assert "trials: a</figure>" in errors_over_time("a", [log, log])
    assert len(without_details(log).steps) == 1


def test_without_a_valid_trial_no_error_is_drawn():
    assert total_errors([group(batch([[1.0]] * 2, outcome=Outcome.ABORTED))], {}) == ""
