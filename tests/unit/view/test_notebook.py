"""Tests of how results are displayed in a notebook, without `print` or `%matplotlib inline`."""

import importlib
import re
from html import unescape
from types import SimpleNamespace

import pytest
from testkit import trials
from testkit.paths import ROOT

import tetractl
from tetractl.core.errors import UsageError
from tetractl.log.read.reader import read_trial
from tetractl.statistics.open_batch import Batch, Batches
from tetractl.view.terminal.progress import NotebookProgress

EVIL = '<img src=x onerror="alert(1)">'
SPEC = {
    "name": "two",
    "description": EVIL,
    "arena": {"left": 0, "bottom": 0, "width": 1000, "height": 1000},
    "robots": [
        {"name": "a", "start": [200, 500], "target": [600, 500], "a": 6, "speed": 180},
        {"name": "b", "start": [200, 700], "target": [500, 800], "a": 3, "speed": 150},
    ],
    "controller": {"type": "pso-mpc", "period": 0.2, "horizon_max": 8, "steps_max": 6},
    "plant": {"measurement_noise": {"position": 2}},
    "trials": {"count": 2, "seed": 4},
}
SHOW = {
    "a spec": lambda batch: tetractl.parse_spec(SPEC),
    "a trial": lambda batch: tetractl.read_log(batch.trials[0].log),
    "a trial of a batch": lambda batch: batch.trials[0],
    "a batch": lambda batch: batch,
    "a summary": tetractl.summarise,
    "a comparison": lambda batch: tetractl.compare(batch, batch),
    "a contrast": lambda batch: tetractl.compare(batch, batch).contrasts[0],
    "a study": lambda batch: Batches({"one": batch, "other": batch}),
    "a verification": lambda batch: tetractl.verify(batch.trials[0].log),
    "a player": lambda batch: tetractl.show(batch),
    "a video": lambda batch: tetractl.plot(batch.trials[0].log, "video"),
    "a figure": lambda batch: tetractl.plot(batch, "errors"),
    "a figure of a comparison": lambda batch: tetractl.plot(tetractl.compare(batch, batch)),
    "a table of trials": tetractl.to_dataframe,
}


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    return tetractl.run_batch(SPEC, tmp_path_factory.mktemp("batch"), progress=False)


@pytest.mark.long  # draws
@pytest.mark.parametrize("name", SHOW)
def test_a_result_shows_itself(batch, name):
    """Regression: a figure was `<Figure ...>`, and a summary 400 to 2,500 characters of repr."""
    result = SHOW[name](batch)
    if name.startswith("a figure"):
        png, size = result._repr_png_()
        assert png.startswith(b"\x89PNG")
        assert 300 < size["width"] < 900
        return
    html = result._repr_html_()
    assert re.search(r"<table|<img|<iframe|decisions", html)
    assert EVIL not in html
    assert not re.search(r"<script|(src|href)=.?http", html)


def test_numbers_are_those_of_stats(batch):
    mean = tetractl.summarise(batch).total.mean
    assert f'<td class="short">{mean:.1f}</td>' in batch._repr_html_()
    assert unescape(tetractl.parse_spec(SPEC)._repr_html_()).count(EVIL) == 1


def test_the_player_is_in_a_sandbox(batch):
    (frame,) = re.findall(
        r'<iframe sandbox="([^"]*)" srcdoc="([^"]*)"', tetractl.show(batch)._repr_html_()
    )
    allowed, page = frame
    assert allowed == "allow-scripts"
    assert "default-src &#x27;none&#x27;" in page
    assert unescape(page).count('id="trial-data-') == 2


@pytest.mark.long  # draws
def test_what_cannot_be_shown_says_why(tmp_path, batch):
    assert "there is no trial to summarise" in Batch(())._repr_html_()
    torn = read_trial(trials.write_torn(tmp_path / "torn.mcap"))
    assert "damaged: " in torn._repr_html_()
    other = tetractl.run_trial(tetractl.parse_spec(SPEC, "robots.a.a=5"), folder=tmp_path / "a")
    mixed = tetractl.read_batch(other.log, batch.trials[0].log)
    assert "different experiments" in mixed._repr_html_()


@pytest.mark.long  # draws
def test_a_video_is_of_one_trial_and_is_written_where_it_is_wanted(tmp_path, batch):
    log = batch.trials[0].log
    with pytest.raises(UsageError, match="a video shows one trial, not 2"):
        tetractl.plot(batch, "video")
    video = tetractl.plot(log, "video", file=tmp_path / "trial.gif")
    assert video.format == "gif"
    assert (tmp_path / "trial.gif").read_bytes() == video.data


def test_an_error_is_its_message_and_the_line_that_caused_it():
    """IPython prints what `_render_traceback_` returns."""
    with pytest.raises(tetractl.TetractlError) as caught:
        tetractl.read_log("none.mcap")
    message, *below = caught.value._render_traceback_()
    assert message == f"{type(caught.value).__name__}: {caught.value}"
    assert re.fullmatch(r'line \d+: tetractl.read_log\("none.mcap"\)', below[0])
    assert "traceback.print_last()" in below[-1]


def test_a_notebook_has_one_bar_that_grows():
    times = iter([0.0, 0.1, 0.5, 0.6])
    updates = []
    output = SimpleNamespace(update=lambda bar: updates.append(bar._repr_html_()))
    progress = NotebookProgress(3, lambda bar, display_id: output, lambda: next(times))
    for left_s in (8.0, 4.0, 0.0):
        progress.trial_ended(SimpleNamespace(remaining_s=left_s))
    assert updates == [
        '<progress value="2" max="3"></progress> 2 of 3 trials; 4 s left',
        '<progress value="3" max="3"></progress> 3 of 3 trials',
    ]


@pytest.mark.system  # a kernel
@pytest.mark.release  # what cells call: test_api.py; README shows batches compared
def test_the_example_notebook_runs_and_stores_what_it_shows():
    """Each cell shows what it ends with; the last one is a mistake."""
    for needed in ("nbformat", "nbclient"):
        pytest.importorskip(needed)
    make_notebook = importlib.import_module("make_notebook")
    notebook = make_notebook.executed()
    *cells, mistake = [cell for cell in notebook.cells if cell.cell_type == "code"]
    for cell in cells:
        kinds = [kind for output in cell.outputs for kind in output.get("data", ())]
        assert {"text/html", "image/png"} & {*kinds}, cell.source
    assert len(cells) >= 12
    (error,) = mistake.outputs
    assert error.traceback[0].endswith("did you mean 'speed'?")
    assert "site-packages" not in "".join(error.traceback)
    stored = make_notebook.nbformat.read(make_notebook.NOTEBOOK, as_version=4)
    told = "run: python docs/make_notebook.py"
    assert make_notebook.words(stored) == make_notebook.words(notebook), told


def test_the_stored_pictures_are_small():
    stored = (ROOT / "examples" / "notebook.ipynb").read_text("utf-8")
    assert 60_000 < len(stored) < 130_000
