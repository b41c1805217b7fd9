import numpy as np
import pytest
from support.batches import DISTURBED, REFERENCE, batch, experiment

from tetractl.core.errors import LogError, UsageError
from tetractl.core.plan import Outcome
from tetractl.stats.comparison import compare
from tetractl.stats.summary import summarise
from tetractl.view.figures.batch import batch_figure
from tetractl.view.style import file_format, save

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3))
STARTS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.mark.parametrize("suffix", STARTS)
def test_the_suffix_chooses_the_format_and_a_batch_always_gives_the_same_bytes(tmp_path, suffix):
    paths = [tmp_path / f"{name}.{suffix}" for name in ("one", "two")]
    for path in paths:
        save(batch_figure(summarise(batch(ERRORS.tolist()))), path)
    one, two = (path.read_bytes() for path in paths)
    assert one.startswith(STARTS[suffix])
    assert one == two


def dots(axes):
    return [line for line in axes.lines if line.get_alpha() == 0.55]


def test_every_counted_trial_is_a_dot_at_its_error():
    spec = experiment(reference=REFERENCE)
    ours, theirs = summarise(batch(ERRORS.tolist(), spec)), summarise(batch(ERRORS[:7].tolist()))
    left, right = batch_figure(ours, compare(ours, theirs)).axes
    drawn = [sorted(line.get_ydata()) for line in dots(left)]
    assert drawn == [sorted(ours.totals), sorted(theirs.totals)]
    assert [sorted(line.get_ydata()) for line in dots(right)] == np.sort(ERRORS.T).tolist()
    labels = [tick.get_text() for tick in left.get_xticklabels()]
    assert labels == ["this batch\nn = 20", "against\nn = 7", "published\nn = 20"]


def test_dots_of_equal_errors_lie_side_by_side():
    (axes, _) = batch_figure(summarise(batch([[100.0]] * 9))).axes
    assert len(set(dots(axes)[0].get_xdata())) == 9


def test_nothing_to_plot_is_an_error():
    aborted = summarise(batch(ERRORS.tolist(), outcome=Outcome.ABORTED))
    with pytest.raises(LogError, match="no complete trial"):
        batch_figure(aborted)


def test_a_file_that_cannot_be_written_is_refused_at_once(tmp_path):
    file_format(tmp_path / "batch.PNG")
    with pytest.raises(UsageError, match=r"cannot write '\.gif' pictures"):
        file_format(tmp_path / "batch.gif")
    with pytest.raises(UsageError, match="there is no folder"):
        file_format(tmp_path / "nowhere" / "batch.png")


def test_a_headline_says_what_was_steered():
    ours = summarise(batch(ERRORS.tolist(), experiment(plant=DISTURBED)))
    theirs = summarise(batch(ERRORS.tolist()))
    assert batch_figure(ours).texts[0].get_text() == "disturbed simulation"
    both = batch_figure(ours, compare(ours, theirs)).texts[0].get_text()
    assert both == "this batch: disturbed simulation; against: undisturbed simulation"
