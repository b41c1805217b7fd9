"""What `unmodelled.py` takes for the truth, against what robots do."""

import numpy as np
import pytest
from support.plants import sim, truths
from support.trials import experiment
from unmodelled import true

from tetractl.core.clock import SECOND
from tetractl.core.commands import Turn


@pytest.mark.parametrize("part", ["gain_error", "radius_error"])
def test_the_true_a_of_robots_on_wheels_is_that_by_which_they_turn(part):
    """Regression: errors of gains and radii were left out, so that intervals seemed to miss a."""
    fine = {"camera_rate": 1000, "truth_rate": 1000, "drive": {"rate": 1000, part: 0.1}}
    plant = sim(experiment(plant=fine, wheels={"radius": 40}, obstacles=[]))
    plant.open()
    plant.send(Turn(np.pi / 2))
    plant.clock.sleep_until(SECOND // 4)
    path = truths(plant.samples())[..., 2]
    # by (3), tan((u - heading) / 2) decays with the rate a
    remaining = np.log(np.tan((np.pi / 2 - path) / 2))
    turns = (remaining[0] - remaining[-1]) / ((len(path) - 1) / 1000)
    assert true(plant)["a"] == pytest.approx(turns, rel=0.01)
    assert np.abs(turns / plant.setup.a - 1).max() > 0.02
