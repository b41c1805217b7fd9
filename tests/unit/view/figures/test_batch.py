"""Tests of the figure of batches: a dot for each trial, and the distribution of errors."""

import re

import numpy as np
import pytest
from testkit.batches import DISTURBED, REFERENCE, batch, experiment, group

from tetractl.core.errors import LogError
from tetractl.core.plan import Outcome
from tetractl.view.figures.batch import batch_figure
from tetractl.view.style import save, svg

pytestmark = pytest.mark.slow

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3))
STARTS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.mark.long
@pytest.mark.parametrize("suffix", STARTS)
def test_the_suffix_chooses_the_format_and_a_batch_always_gives_the_same_bytes(tmp_path, suffix):
    first = tmp_path / f"one.{suffix}"
    second = tmp_path / f"two.{suffix}"
    for path in (first, second):
        statistics = group(batch(ERRORS.tolist()))
        save(batch_figure([statistics]), path)
    assert first.read_bytes().startswith(STARTS[suffix])
    assert first.read_bytes() == second.read_bytes()


def heights(axes):
    """The heights of each batch's dots, one a trial."""
    batches = [dots for dots in axes.collections if dots.get_gid() == "trials"]
    return [sorted(dots.get_offsets()[:, 1]) for dots in batches]


def test_every_counted_trial_is_a_dot_at_its_error_and_a_step_of_its_batchs_curve():
    spec = experiment(reference=REFERENCE)
    ours = group(batch(ERRORS.tolist(), spec), name="ours")
    theirs = group(batch(ERRORS[:7].tolist()), name="theirs-a=3")
    of_dots, of_curves = batch_figure([ours, theirs]).axes
    assert heights(of_dots) == [sorted(ours.totals), sorted(theirs.totals)]
    means = [float(line.get_ydata()[0]) for line in of_dots.lines[:2]]
    assert means == pytest.approx([np.mean(ours.totals), np.mean(theirs.totals)])
    labels = [(tick.get_text(), tick.get_rotation()) for tick in of_dots.get_xticklabels()]
    assert labels == [("ours\nn = 20", 0), ("theirs\na=3\nn = 7", 0), ("published\nn = 20", 0)]
    assert [line.get_label() for line in of_curves.lines[:2]] == ["ours", "theirs-a=3"]
    error, share = of_curves.lines[0].get_data()
    assert list(error[1:-1]) == sorted(ours.totals)
    assert list(share) == pytest.approx([*np.arange(21) / 20, 1])
    assert len(of_curves.collections) == 2  # a band for each


def test_trials_of_the_same_error_are_dots_next_to_one_another():
    (of_dots, _) = batch_figure([group(batch([[5.9, 0, 0]] * 20))]).axes
    (dots,) = [drawn for drawn in of_dots.collections if drawn.get_gid() == "trials"]
    asides = np.sort(dots.get_offsets()[:, 0])
    assert np.diff(asides).min() > 0.005  # categories


@pytest.mark.long
def test_a_dot_links_to_its_trial():
    statistics = group(batch(ERRORS[:3].tolist()))
    links = {trial.log: f"#trial-{i}" for i, trial in enumerate(statistics.batch.trials, 1)}
    drawing = svg(batch_figure([statistics], links)).decode()
    assert re.findall(r'xlink:href="#(trial-\d+)"', drawing) == ["trial-1", "trial-2", "trial-3"]
    assert "#trial-" not in svg(batch_figure([statistics])).decode()


def test_nothing_to_plot_is_an_error():
    aborted = group(batch(ERRORS.tolist(), outcome=Outcome.ABORTED))
    with pytest.raises(LogError, match="no complete trial"):
        batch_figure([aborted])


def test_a_batch_of_which_one_error_is_thirty_times_another_has_logarithmic_axes():
    near = group(batch([[10.0, 0, 0], [12.0, 0, 0]]), name="near")
    far = group(batch([[300.0, 0, 0]]), name="far")
    of_dots, of_curves = batch_figure([near, far]).axes
    assert (of_dots.get_yscale(), of_curves.get_xscale()) == ("log", "log")
    of_dots, of_curves = batch_figure([near]).axes
    assert (of_dots.get_yscale(), of_curves.get_xscale()) == ("linear", "linear")


def headline_of(*groups):
    """The line above the figure that names the plants."""
    return batch_figure(list(groups)).texts[0].get_text()


def test_the_plants_are_named_once_or_with_their_batches_where_they_differ():
    rows = ERRORS[:4].tolist()
    undisturbed = group(batch(rows), name="a")
    assert headline_of(undisturbed) == "undisturbed simulation"
    assert headline_of(undisturbed, group(batch(rows), name="b")) == "undisturbed simulation"
    disturbed = group(batch(rows, experiment(plant=DISTURBED)), name="c")
    assert headline_of(undisturbed, disturbed) == (
        "a: undisturbed simulation; c: disturbed simulation"
    )
    aborted = group(batch(rows, experiment(plant=DISTURBED), outcome=Outcome.ABORTED), name="d")
    assert headline_of(undisturbed, aborted) == "undisturbed simulation"  # d has no error to draw
