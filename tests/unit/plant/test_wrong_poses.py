"""A disturbance whose poses or times no log can hold ends the trial before they are logged."""

from typing import Literal

import numpy as np
import pytest
from support.plants import sim
from support.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.errors import WrongValueError
from tetractl.core.poses import Poses
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection

pytestmark = pytest.mark.slow


class Wrong(DisturbanceSection):
    """Puts all robots at `x`, or returns the poses of one robot only."""

    type: Literal["wrong"] = "wrong"
    method: str
    x: float | None

    def build(self, setup, rng):
        rows = setup.starts.array()
        rows[:, 0] = 0.0 if self.x is None else self.x
        poses = Poses.of(rows[:1] if self.x is None else rows)
        overrides = {
            "moved": lambda one, old, moving, seconds, time_s: poses,
            "measured": lambda one, old, valid, time_s: (poses, valid),
        }
        return type("Made", (Disturbance,), {self.method: overrides[self.method]})()


@pytest.mark.parametrize(
    ("method", "x"),
    [
        *(("moved", x) for x in (np.nan, np.inf, 1e300, None)),
        *(("measured", x) for x in (np.nan, np.inf, 1e300)),
    ],
)
def test_poses_that_no_log_can_hold_end_the_trial(method, x):
    section = Wrong.model_construct(type="wrong", method=method, x=x)
    spec = experiment()
    plant = spec.plant.model_copy(update={"disturbances": (section,)})
    plant = sim(spec.model_copy(update={"plant": plant}))
    with pytest.raises(WrongValueError, match="pose that no log can hold"):
        plant.open()
        plant.send(Steer(0.0))
        plant.clock.sleep_until(SECOND)
        plant.samples()


class Untimely(DisturbanceSection):
    """Returns `value` as a frame's arrival or as a planning time."""

    type: Literal["untimely"] = "untimely"
    method: str
    value: float

    def build(self, setup, rng):
        return type("Made", (Disturbance,), {self.method: lambda *_: self.value})()


@pytest.mark.parametrize(
    ("method", "value"),
    [("received", np.nan), ("received", -1), *(("planning_s", x) for x in (np.nan, -1.0, 10**30))],
)
def test_times_that_no_log_can_hold_end_the_trial(method, value):
    section = Untimely.model_construct(type="untimely", method=method, value=value)
    spec = experiment()
    plant = spec.plant.model_copy(update={"disturbances": (section,)})
    plant = sim(spec.model_copy(update={"plant": plant}))
    plant.open()
    with pytest.raises(WrongValueError, match=r"arrival of a frame before|a planning time of"):
        plant.send(Steer(0.0))
        plant.clock.sleep_until(SECOND)
        plant.samples()
