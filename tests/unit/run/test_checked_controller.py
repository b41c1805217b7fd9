"""What a controller of another package returns is checked before it is sent and logged."""

from dataclasses import replace
from itertools import count
from typing import Literal

import numpy as np
import pytest
from pydantic import PrivateAttr
from support.random_trials import trial, write
from support.trials import experiment

from tetractl.control.optimizers.pso import Pso
from tetractl.core.commands import Stop, Turn
from tetractl.core.errors import WrongValueError
from tetractl.core.plan import End, Estimate, Outcome, Plan, Search, StopReason
from tetractl.core.poses import Observation, Poses
from tetractl.experiment.controller import ControllerSection
from tetractl.log.read.reader import read_trial
from tetractl.run.checked_controller import NUMBERS_MAX, CheckedController

SETUP = experiment().setup
ROBOTS = len(SETUP.names)
SEEN = Observation(0, 0, 0, SETUP.starts, np.ones(ROBOTS, dtype=np.bool_))


class OddError(Exception):
    def __str__(self):
        raise ValueError("no text")


class Odd:
    """An object that cannot even be shown."""

    def __repr__(self):
        raise OddError

    __array__ = __float__ = __index__ = __repr__


class Given(ControllerSection):
    """A controller that returns what it is given."""

    type: Literal["given"] = "given"
    _returned: object = PrivateAttr()
    _own: object = PrivateAttr()

    def build(self, setup, key, host=None):
        self._own = setup
        return self

    def plan(self, observation, last_command=None, earlier=()):
        return self._returned


def decided(returned):
    section = Given()
    section._returned = returned
    return CheckedController(section, SETUP, 1).plan(SEEN)


def plan(length=2, **changed):
    signals = np.full(length, 0.5)
    cost = 3.0
    search = Search(length, signals, cost, np.array([cost]), 1, StopReason.CRITERION)
    path = np.zeros((length + 1, ROBOTS, 3))
    return replace(Plan(signals, path, cost, cost, 0.0, (search,), 0, 0), **changed)


def searched(**changed):
    good_plan = plan()
    return replace(good_plan, searches=(replace(good_plan.searches[0], **changed),))


def at(value):
    path = np.zeros((3, ROBOTS, 3))
    path[1, 0, 0] = value
    return path


def estimate(**changed):
    ones = np.ones(ROBOTS)
    return plan(estimate=replace(Estimate(ones, ones, ones, ones), **changed))


WRONG = {
    "text": "east", "None": None, "a class": Plan, "an object": Odd(), "a generator": count(),
    "path nan": plan(path=at(np.nan)), "path inf": plan(path=at(np.inf)),
    "path beyond single precision": plan(path=at(1e39)),
    "path of one robot more": plan(path=np.zeros((3, 4, 3))),
    "path too long": plan(path=np.zeros((4, ROBOTS, 3))), "path None": plan(path=None),
    "path of objects": plan(path=at(0).astype(object)), "path flat": plan(path=at(0)[0, 0]),
    "path without headings": plan(path=at(0)[..., :2]), "path an object": plan(path=Odd()),
    "signals nan": plan(signals=np.full(2, np.nan)),
    "signals None": plan(signals=None), "signals text": plan(signals="east"),
    "signals 2-D": plan(signals=np.zeros((2, 1))), "signals 0-D": plan(signals=np.array(0.5)),
    "no signals": plan(0), "signals complex": plan(signals=np.full(2, 1j)), "million": plan(10**6),
    "long": plan(NUMBERS_MAX // 2), "cost nan": plan(cost=np.nan),
    "cost text": plan(cost="low"), "cost None": plan(cost=None), "cost object": plan(cost=Odd()),
    "target cost": plan(target_cost=-np.inf), "chosen": plan(chosen=1), "-1": plan(chosen=-1),
    "chosen 0.5": plan(chosen=0.5), "no search": plan(searches=()), "searches": plan(searches="a"),
    "searches None": plan(searches=None), "generator -1": plan(generator=-1),
    "generator 2**64": plan(generator=2**64), "generator 0.5": plan(generator=0.5),
    "leg -1": plan(leg=-1), "leg 2": plan(leg=2), "leg text": plan(leg="first"),
    "delay -1": plan(delay_ns=-1), "delay of a day": plan(delay_ns=86_400 * 10**9, instead=Stop()),
    "delay 0.5": plan(delay_ns=0.5), "state": plan(state="dancing"), "instead": plan(instead="no"),
    "turn nan": plan(instead=Turn(np.nan)), "turn text": plan(instead=Turn("north")),
    "length": searched(length=7), "history": searched(history=np.zeros(0)),
    "history nan": searched(history=np.array([np.nan])), "history None": searched(history=None),
    "search cost": searched(cost=np.nan), "evaluations": searched(evaluations=-1),
    "evaluations 2**63": searched(evaluations=2**63),
    "evaluations 0.5": searched(evaluations=0.5), "stopped": searched(stopped=None),
    "estimate": plan(estimate="good"), "estimate nan": estimate(a=np.full(ROBOTS, np.nan)),
    "estimate of 2": estimate(speed=np.ones(2)), "misfit": estimate(misfit=np.ones((ROBOTS, 2))),
    "dead time": estimate(dead_time=np.inf), "end": End(Outcome.ARRIVED, 10**30),
    "end -1": End(Outcome.ARRIVED, -1), "end text": End("arrived", 0),
    "end None": End(Outcome.ARRIVED, None), "outcome text": "arrived",
    "aborted": Outcome.ABORTED, "interrupted": Outcome.INTERRUPTED,
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_sent_and_logged_is_refused(name):
    with pytest.raises(WrongValueError) as raised:
        decided(WRONG[name])
    assert str(raised.value).startswith("controller 'given' returned a ")
    assert "\n" not in raised.value.message
    assert isinstance(raised.value.giver, Given)


class Silent(Pso):
    """An optimiser that does not say why it ended."""

    def search(self, *arguments):
        return replace(super().search(*arguments), stopped=None)


def test_what_an_optimiser_of_another_package_gives_is_refused():
    """Regression: the log could not hold it, and stayed a .part."""
    optimizer = Silent(particles=2, iterations=1)
    section = experiment().controller.model_copy(update={"optimizer": optimizer})
    with pytest.raises(WrongValueError, match="a search was stopped by NoneType, not a text"):
        CheckedController(section, SETUP, 1).plan(SEEN)


FINE = {
    "plan": plan(),
    "large": plan(path=at(1e38), signals=np.full(2, -1e300)),
    "as long as it may be": plan(NUMBERS_MAX // 12),
    "lists": plan(signals=[0.5, 0.5], path=at(1.0).tolist(), searches=list(plan().searches)),
    "single precision": plan(signals=np.full(2, 0.5, np.float32), cost=np.float32(3)),
    "whole numbers": plan(signals=np.array([1, 2]), chosen=np.int64(0), generator=np.uint64(2**63)),
    "cost 1e200": plan(cost=1e200), "stopped": searched(stopped="\x1b[31m" + 10**6 * "x"),
    "estimate": estimate(heading_bias=np.zeros(ROBOTS), dead_time=0.1),
}  # fmt: skip


@pytest.mark.parametrize("name", FINE)
def test_what_is_sent_is_read(name, tmp_path):
    played = trial(steps=12)
    taken = decided(FINE[name])
    samples, step = played.rounds[5]
    played.rounds[5] = samples, replace(step, plan=taken)
    read = read_trial(write(played, tmp_path / "trial.mcap")).steps[5].plan
    assert read.signals.tolist() == list(taken.signals)
    assert (read.cost, read.chosen, read.generator) == (taken.cost, 0, taken.generator)
    assert read.searches[0].stopped == taken.searches[0].stopped


def test_arrays_that_are_changed_later_change_nothing():
    returned = plan()
    section = Given()
    section._returned = returned
    controller = CheckedController(section, SETUP, 1)
    taken = controller.plan(SEEN)
    targets = SETUP.targets.copy()
    for array in (returned.signals, returned.path, returned.searches[0].history):
        array[:] = np.nan
    section._own.targets[:] = 0
    assert taken.signals.tolist() == taken.search.signals.tolist() == [0.5, 0.5]
    assert not np.isnan([*taken.path.ravel(), *taken.search.history]).any()
    assert (targets == SETUP.targets).all()


def test_what_was_seen_cannot_be_overwritten():
    observation = Observation(0, 0, 0, Poses(*np.zeros((3, 2))), np.ones(2, dtype=np.bool_))
    for array in (
        observation.poses.x,
        observation.poses.y,
        observation.poses.heading,
        observation.valid,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 1
