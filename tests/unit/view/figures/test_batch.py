import re

import numpy as np
import pytest
from support.batches import DISTURBED, REFERENCE, batch, experiment, group

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
    paths = [tmp_path / f"{name}.{suffix}" for name in ("one", "two")]
    for path in paths:
        save(batch_figure([group(batch(ERRORS.tolist()))]), path)
    one, two = (path.read_bytes() for path in paths)
    assert one.startswith(STARTS[suffix])
    assert one == two


def dots(axes):
    return [found for found in axes.collections if found.get_gid() == "trials"]


def heights(axes):
    return [sorted(found.get_offsets()[:, 1]) for found in dots(axes)]


def test_every_counted_trial_is_a_dot_at_its_error():
    spec = experiment(reference=REFERENCE)
    ours = group(batch(ERRORS.tolist(), spec), name="ours")
    theirs = group(batch(ERRORS[:7].tolist()), name="theirs")
    left, right = batch_figure([ours, theirs]).axes
    assert heights(left) == [sorted(ours.totals), sorted(theirs.totals)]
    curve = right.lines[0].get_xdata()
    assert list(curve[1:-1]) == sorted(ours.totals)
    labels = [tick.get_text() for tick in left.get_xticklabels()]
    assert labels == ["ours\nn = 20", "theirs\nn = 7", "published\nn = 20"]


def test_a_batch_without_a_controller_is_called_given_directions():
    given = experiment(controller={"type": "sequence", "directions": [0.1]})
    left = batch_figure([group(batch(ERRORS[:7].tolist(), given), name="a")]).axes[0]
    labels = [tick.get_text() for tick in left.get_xticklabels()]
    assert labels == ["this batch\nn = 7\ngiven directions"]


def test_a_dot_links_to_its_trial(tmp_path):
    found = group(batch(ERRORS[:3].tolist()))
    links = {trial.log: f"#trial-{i}" for i, trial in enumerate(found.batch.trials, 1)}
    drawing = svg(batch_figure([found], links)).decode()
    assert re.findall(r'xlink:href="#(trial-\d+)"', drawing) == ["trial-1", "trial-2", "trial-3"]
    assert "#trial-" not in svg(batch_figure([found])).decode()


def test_nothing_to_plot_is_an_error():
    aborted = group(batch(ERRORS.tolist(), outcome=Outcome.ABORTED))
    with pytest.raises(LogError, match="no complete trial"):
        batch_figure([aborted])


def test_a_headline_names_the_plants():
    ours = group(batch(ERRORS.tolist(), experiment(plant=DISTURBED)), name="a")
    theirs = group(batch(ERRORS.tolist()), name="b")
    assert batch_figure([ours]).texts[0].get_text() == "disturbed simulation"
    both = batch_figure([ours, theirs]).texts[0].get_text()
    assert both == "a: disturbed simulation; b: undisturbed simulation"
