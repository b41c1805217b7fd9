"""Tests of what `plot`, `show` and `play_page` draw from what they are given."""

import shutil
from pathlib import Path

import pytest
from testkit.batches import batch, experiment, group
from testkit.paths import ROOT

import tetractl
from tetractl.api.logs import as_batch, as_trial, as_trials
from tetractl.core.errors import SpecError, UsageError
from tetractl.statistics.describe import contrast
from tetractl.statistics.open_batch import Batch

LOG = ROOT / "tests/golden/format-4-sim.mcap"
ERRORS = [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0], [3.0, 4.0, 5.0]]


@pytest.fixture
def drawn(monkeypatch):
    """What is drawn: the kind of figure and its data; nothing is drawn really."""
    asked = []
    monkeypatch.setattr(
        "tetractl.view.figures.draw.draw", lambda kind, trials: asked.append((kind, trials))
    )
    monkeypatch.setattr(
        "tetractl.view.figures.batch.batch_figure", lambda groups: asked.append(("batch", groups))
    )
    monkeypatch.setattr(
        "tetractl.view.video.video", lambda trial, file: asked.append(("video", [trial], file))
    )
    saved = []
    monkeypatch.setattr("tetractl.view.style.save", lambda figure, file: saved.append(file))
    asked.append(saved)
    return asked


def test_trials_are_drawn_as_asked_and_statistics_as_a_batch(drawn):
    trial = tetractl.read_log(LOG)
    statistics = group(batch(ERRORS))
    comparison = contrast([statistics, statistics])
    tetractl.plot(trial)
    tetractl.plot([trial, trial], "errors")
    tetractl.plot(statistics, "errors")
    tetractl.plot(comparison)
    saved, *asked = drawn
    assert asked == [
        ("trajectory", [trial]),
        ("errors", [trial, trial]),
        ("batch", [statistics]),
        ("batch", comparison.groups),
    ]
    assert saved == []


def test_a_figure_is_saved_only_in_a_file_that_is_named(drawn):
    tetractl.plot(LOG, file="a.png")
    assert drawn[0] == [Path("a.png")]


@pytest.mark.parametrize(("file", "path"), [(None, None), ("a.gif", Path("a.gif"))])
def test_a_video_is_of_one_trial(drawn, file, path):
    trial = tetractl.read_log(LOG)
    tetractl.plot(trial, "video", file=file)
    assert drawn[1:] == [("video", [trial], path)]
    assert drawn[0] == []
    with pytest.raises(UsageError, match="a video shows one trial, not 2"):
        tetractl.plot([trial, trial], "video")


def test_trials_are_given_as_themselves_as_logs_or_as_a_folder(tmp_path):
    path = Path(shutil.copy(LOG, tmp_path / "trial-000.mcap"))
    trial = tetractl.read_log(LOG)
    assert as_trial(trial) is trial
    for data in (path, str(path), tmp_path, [path], as_batch(tmp_path)):
        (read,) = as_trials(data)
        assert read.mocap.tolist() == trial.mocap.tolist()
    assert as_trials([trial, path])[0] is trial
    with pytest.raises(UsageError, match="the list of trials to draw is empty"):
        as_trials([])


def test_a_batch_is_given_as_itself_as_a_folder_or_as_logs(tmp_path):
    path = Path(shutil.copy(LOG, tmp_path / "trial-000.mcap"))
    whole = Batch.from_results(batch(ERRORS))
    assert as_batch(whole) is whole
    for data in (tmp_path, str(tmp_path), [path]):
        assert len(as_batch(data).trials) == 1
    with pytest.raises(UsageError, match="no log is given"):
        as_batch([])


def test_a_page_is_not_written_into_a_folder_that_is_missing(tmp_path):
    with pytest.raises(UsageError, match=r"the folder .*none does not exist"):
        tetractl.play_page(tmp_path / "s.yaml", file=tmp_path / "none" / "page.html")


def test_what_cannot_be_steered_by_hand_has_no_page(tmp_path):
    fields = experiment(1, hold={"radius": 9, "time": 3}, controller={"type": "mpc"})
    with pytest.raises(SpecError, match="hold"):
        tetractl.play_page(fields.model_dump(mode="json"), file=tmp_path / "page.html")
    assert list(tmp_path.iterdir()) == []
