"""Tests of a given sequence of directions: what each step sends and foresees, and its end."""

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.control.methods.sequence import SequenceSection
from tetractl.core.clock import SECOND
from tetractl.core.plan import End, Outcome
from tetractl.core.poses import Observation

pytestmark = pytest.mark.slow


def decisions(directions, steps, remainder=0.0):
    fields = {"type": "sequence", "directions": directions, "remainder": remainder}
    spec = experiment(controller=fields)
    controller = spec.controller.build(spec.setup, 3)
    seen = np.ones(3, np.bool_)
    period_ns = round(spec.controller.period * SECOND)
    return [
        controller.plan(Observation(k, k * period_ns, k * period_ns, spec.setup.starts, seen))
        for k in range(steps)
    ]


def test_each_step_sends_the_next_direction_and_foresees_the_rest():
    directions = [0.1, 0.2, -0.3]
    plans = decisions(directions, 3)
    assert [plan.direction for plan in plans] == directions
    assert [plan.signals.tolist() for plan in plans] == [directions, directions[1:], directions[2:]]
    assert plans[0].path.shape == (4, 3, 3)


def test_a_long_sequence_is_foreseen_for_some_signals_only():
    directions = np.linspace(-1, 1, SequenceSection.ahead + 5).tolist()
    first, second = decisions(directions, 2)
    assert first.signals.tolist() == directions[: SequenceSection.ahead]
    assert second.signals.tolist() == directions[1 : SequenceSection.ahead + 1]


def test_after_the_last_direction_the_trial_ends_at_once_or_after_the_remainder():
    assert decisions([0.1, 0.2], 3)[-1] is Outcome.SEQUENCE_COMPLETED
    end = decisions([0.1, 0.2], 3, remainder=0.07)[-1]
    assert end == End(Outcome.SEQUENCE_COMPLETED, 70_000_000)


def test_its_bound_is_the_number_of_directions():
    section = SequenceSection(type="sequence", directions=(0.1, 0.2))
    assert section.bounds() == {"directions": "2"}
