"""Tests that the results of a foreign controller are checked before they are sent and logged."""

from dataclasses import replace
from itertools import count
from typing import Any, Literal

import numpy as np
import pytest
from testkit.random_trials import trial, write
from testkit.trials import experiment

from tetractl.control.search.optimizers.pso import Pso
from tetractl.core.clock import SECOND
from tetractl.core.commands import Stop, Turn
from tetractl.core.errors import WrongValueError
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import End, Outcome, Plan, Search, StopReason
from tetractl.core.poses import Observation, Poses
from tetractl.log.read.limits import CHUNK_MAX
from tetractl.log.read.reader import read_trial
from tetractl.run.checked_controller import PLAN_SIZE_MAX, CheckedController
from tetractl.spec.controller import ControllerSection

SETUP = experiment().setup
ROBOTS = len(SETUP.names)
SEEN = Observation(0, 0, 0, SETUP.starts, np.ones(ROBOTS, dtype=np.bool_))


class MuteError(Exception):
    """Stands for an error without a text."""

    def __str__(self):
        raise ValueError("no text")


class Odd:
    """Stands for an object that is neither shown nor made a number."""

    def __repr__(self):
        raise MuteError

    __array__ = __float__ = __index__ = __repr__


class ForeignController:
    """Stands for a controller of another package that decides for `decision` in each step; `setup`
    is the one that it was given."""

    def __init__(self, decision, setup):
        self.decision = decision
        self.setup = setup

    def plan(self, observation, last_command=None, earlier=()):
        return self.decision


class Given(ControllerSection):
    """Stands for the section of such a controller."""

    type: Literal["given"] = "given"
    decision: Any = None

    def build(self, setup, key, host=None):
        return ForeignController(self.decision, setup)


def checked(decision):
    """A controller that decides so, and is checked."""
    return CheckedController(Given.model_construct(decision=decision), SETUP, 1)


PATH = np.zeros((3, ROBOTS, 3))
"""The path of a plan of two signals."""


def path_with(x):
    """PATH, but for the place of the first robot after the first signal."""
    path = PATH.copy()
    path[1, 0, 0] = x
    return path


def plan(length=2, **changed):
    """A plan that is right, but for what is changed."""
    signals = np.full(length, 0.5)
    cost = 3.0
    search = Search(
        length=length,
        signals=signals,
        cost=cost,
        history=np.array([cost]),
        evaluations=1,
        stopped=StopReason.CRITERION,
    )
    right = Plan(
        signals=signals,
        path=np.zeros((length + 1, ROBOTS, 3)),
        cost=cost,
        target_cost=cost,
        obstacle_cost=0.0,
        searches=(search,),
        chosen=0,
        generator=0,
    )
    return replace(right, **changed)


def searched(**changed):
    """A plan of a search that is right, but for what is changed."""
    (search,) = plan().searches
    return plan(searches=(replace(search, **changed),))


def estimated(**changed):
    """A plan of an estimate that is right, but for what is changed."""
    ones = np.ones(ROBOTS)
    estimate = Estimate(a=ones, a_std=ones, speed=ones, speed_std=ones)
    return plan(estimate=replace(estimate, **changed))


WRONG = {
    # no decision at all
    "text": "east",
    "None": None,
    "a class": Plan,
    "an object": Odd(),
    "a generator": count(),
    # of the path
    "path nan": plan(path=path_with(np.nan)),
    "path inf": plan(path=path_with(np.inf)),
    "path beyond single precision": plan(path=path_with(1e39)),
    "path of one robot more": plan(path=np.zeros((3, ROBOTS + 1, 3))),
    "path too long": plan(path=np.zeros((4, ROBOTS, 3))),
    "path None": plan(path=None),
    "path of objects": plan(path=PATH.astype(object)),
    "path flat": plan(path=PATH[0, 0]),
    "path without headings": plan(path=PATH[..., :2]),
    "path an object": plan(path=Odd()),
    # of the signals
    "signals nan": plan(signals=np.full(2, np.nan)),
    "signals None": plan(signals=None),
    "signals text": plan(signals="east"),
    "signals 2-D": plan(signals=np.zeros((2, 1))),
    "signals 0-D": plan(signals=np.array(0.5)),
    "signals complex": plan(signals=np.full(2, 1j)),
    "no signals": plan(0),
    "million": plan(10**6),
    "long": plan(PLAN_SIZE_MAX // 2),
    # of the numbers
    "cost nan": plan(cost=np.nan),
    "cost text": plan(cost="low"),
    "cost None": plan(cost=None),
    "cost object": plan(cost=Odd()),
    "target cost": plan(target_cost=-np.inf),
    "chosen": plan(chosen=1),
    "-1": plan(chosen=-1),
    "chosen 0.5": plan(chosen=0.5),
    "generator -1": plan(generator=-1),
    "generator 2**64": plan(generator=2**64),
    "generator 0.5": plan(generator=0.5),
    "leg -1": plan(leg=-1),
    "leg 2": plan(leg=2),
    "leg text": plan(leg="first"),
    "delay -1": plan(delay_ns=-1),
    "delay of a day": plan(delay_ns=86_400 * SECOND, instead=Stop()),
    "delay 0.5": plan(delay_ns=0.5),
    "number nan": plan(numbers={"margin_mm": np.nan}),
    "number text": plan(numbers={"margin_mm": "wide"}),
    "number without a name": plan(numbers={"": 1.0}),
    "number with a line for a name": plan(numbers={"margin\n": 1.0}),
    "number with a long name": plan(numbers={"m" * 61: 1.0}),
    "numbers None": plan(numbers=None),
    "numbers a list": plan(numbers=[1.0]),
    "many numbers": plan(numbers={f"n{i}": 1.0 for i in range(101)}),
    # of the action
    "state": plan(state="dancing"),
    "instead": plan(instead="no"),
    "turn nan": plan(instead=Turn(np.nan)),
    "turn text": plan(instead=Turn("north")),
    # of the searches
    "no search": plan(searches=()),
    "searches": plan(searches="a"),
    "searches None": plan(searches=None),
    "length": searched(length=7),
    "history": searched(history=np.zeros(0)),
    "history nan": searched(history=np.array([np.nan])),
    "history None": searched(history=None),
    "search cost": searched(cost=np.nan),
    "evaluations": searched(evaluations=-1),
    "evaluations 2**63": searched(evaluations=2**63),
    "evaluations 0.5": searched(evaluations=0.5),
    "stopped": searched(stopped=None),
    # of the estimate
    "estimate": plan(estimate="good"),
    "estimate nan": estimated(a=np.full(ROBOTS, np.nan)),
    "estimate of 2": estimated(speed=np.ones(2)),
    "misfit": estimated(misfit=np.ones((ROBOTS, 2))),
    "dead time": estimated(dead_time=np.inf),
    # of the end
    "end": End(Outcome.ARRIVED, 10**30),
    "end -1": End(Outcome.ARRIVED, -1),
    "end text": End("arrived", 0),
    "end None": End(Outcome.ARRIVED, None),
    "outcome text": "arrived",
    "aborted": Outcome.ABORTED,
    "interrupted": Outcome.INTERRUPTED,
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_sent_and_logged_is_refused(name):
    with pytest.raises(WrongValueError) as raised:
        checked(WRONG[name]).plan(SEEN)
    assert str(raised.value).startswith("controller 'given' returned a ")
    assert "\n" not in raised.value.message


FINE = {
    "plan": plan(),
    "large": plan(path=path_with(1e38), signals=np.full(2, -1e300)),
    "as long as it may be": plan(PLAN_SIZE_MAX // 12),
    "signals of a list": plan(signals=[0.5, 0.5]),
    "path of a list": plan(path=PATH.tolist()),
    "searches of a list": plan(searches=list(plan().searches)),
    "single precision": plan(signals=np.full(2, 0.5, np.float32), cost=np.float32(3)),
    "whole signals": plan(signals=np.array([1, 2])),
    "whole numbers": plan(chosen=np.int64(0), generator=np.uint64(2**63)),
    "cost 1e200": plan(cost=1e200),
    "stopped": searched(stopped="\x1b[31m" + 10**6 * "x"),
    "estimate": estimated(heading_bias=np.zeros(ROBOTS), dead_time=0.1),
}


@pytest.mark.parametrize("name", FINE)
def test_what_is_sent_is_read(name, tmp_path):
    taken = checked(FINE[name]).plan(SEEN)
    played = trial(steps=12)
    samples, step = played.rounds[5]
    played.rounds[5] = samples, replace(step, plan=taken)
    path = write(played, tmp_path / "trial.mcap")
    read = read_trial(path).steps[5].plan
    assert read.signals.tolist() == list(taken.signals)
    assert (read.cost, read.chosen, read.generator) == (taken.cost, 0, taken.generator)
    assert read.searches[0].stopped == taken.searches[0].stopped


@pytest.mark.parametrize("array", ["x", "y", "heading", "valid"])
def test_what_was_seen_cannot_be_overwritten(array):
    poses = Poses.from_array(np.zeros((2, 3)))
    seen = Observation(0, 0, 0, poses, np.ones(2, dtype=np.bool_))
    arrays = {"x": poses.x, "y": poses.y, "heading": poses.heading, "valid": seen.valid}
    with pytest.raises(ValueError, match="read-only"):
        arrays[array][:] = 1


class Silent(Pso):
    """Stands for an optimiser of another package that does not say why it ended."""

    def search(self, *arguments):
        return replace(super().search(*arguments), stopped=None)


def test_what_an_optimiser_of_another_package_gives_is_refused():
    """Regression: the log could not hold it, and stayed a .part."""
    optimizer = Silent(particles=2, iterations=1)
    section = experiment().controller.model_copy(update={"optimizer": optimizer})
    with pytest.raises(
        WrongValueError,
        match="the field `stopped` of a search must be a string, but it is of type NoneType",
    ):
        CheckedController(section, SETUP, 1).plan(SEEN)


def test_arrays_that_are_changed_later_change_nothing():
    returned = plan()
    taken = checked(returned).plan(SEEN)
    returned.signals[:] = np.nan
    returned.path[:] = np.nan
    returned.search.history[:] = np.nan
    assert taken.signals.tolist() == [0.5, 0.5]
    assert taken.search.signals.tolist() == [0.5, 0.5]
    assert taken.search.history.tolist() == [3.0]
    assert np.array_equal(taken.path, PATH)


def test_a_controller_of_another_package_has_a_setup_of_its_own():
    targets = SETUP.targets.copy()
    controller = checked(plan())
    controller.controller.setup.targets[:] = 0
    assert np.array_equal(SETUP.targets, targets)


def test_the_largest_plan_fits_in_a_chunk_that_the_reader_accepts():
    assert 8 * PLAN_SIZE_MAX <= CHUNK_MAX / 4  # numbers of 8 bytes
