"""Tests of the figure of a search's particles: its contents, and the logs that it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.drawn import overlapping, words
from testkit.trials import cut_short, experiment, three_robots

from tetractl.core.errors import LogError, UsageError
from tetractl.view.figures.draw import draw

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log():
    return three_robots()


def test_the_swarm_is_that_of_the_logged_search(log):
    figure = draw("swarm", [log])
    search = log.steps[0].plan.search
    assert f"first plan, {search.length} signals; J as logged" in words(figure)
    panels = [axes for axes in figure.axes if axes.get_xlabel()]
    assert len(panels) == 3
    titles = [axes.get_title(loc="left") for axes in panels]
    assert f"(a) iteration 0, J {search.history[0]:.3g} mm" == titles[0]
    assert f"(c) iteration {len(search.history) - 1}, J {search.cost:.3g} mm" == titles[2]
    dots = {line.get_gid(): line.get_xydata() for line in panels[2].lines}
    assert dots["best"].tolist() == [search.signals[:2].tolist()]
    assert len(dots["swarm"]) == log.experiment.controller.optimizer.particles
    assert len(dots["course"]) == len(search.history)
    assert np.isclose(dots["course"][-1], dots["swarm"]).all(axis=1).any()


@pytest.mark.long
def test_no_text_hides_another_and_the_plant_is_named(log):
    figure = draw("swarm", [log])
    assert overlapping(figure) == []
    assert log.origin.value in words(figure)


def test_what_has_no_swarm_is_told(log):
    with pytest.raises(LogError, match="contains no"):
        draw("swarm", [cut_short(log, 0)])
    with pytest.raises(UsageError, match="a single trial"):
        draw("swarm", [log, log])
    other = experiment(controller={"optimizer": {"type": "multistart"}})
    with pytest.raises(LogError, match="its optimiser is multistart"):
        draw("swarm", [replace(log, experiment=other)])
    late = (replace(log.steps[0], k=3), *log.steps[1:])
    with pytest.raises(LogError, match="cannot be repeated"):
        draw("swarm", [replace(log, steps=late)])
