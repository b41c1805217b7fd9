import re
from base64 import b64decode

import pytest
from support import random_trials as made

from tetractl.log.read.reader import read_trial
from tetractl.report.page import lean, of_batch
from tetractl.view.figures.draw import draw
from tetractl.view.style import svg

pytestmark = pytest.mark.slow  # draws


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    trials = [made.trial(seed, steps=3, index=seed) for seed in range(3)]
    return [read_trial(made.write(one, folder / f"{i}.mcap")) for i, one in enumerate(trials)]


def pictures(html):
    return [b64decode(data) for data in re.findall(r"base64,([^\"]+)", html)]


def test_a_batch_is_drawn_as_plot_draws_it_though_little_of_it_is_kept(logs):
    shown = of_batch("one & two", [lean(log) for log in logs])
    assert pictures(shown) == [svg(draw(kind, logs)) for kind in ("errors", "scatter")]
    assert shown.count(": one &amp; two<") == 2
    assert of_batch("", logs[:1]) == ""
