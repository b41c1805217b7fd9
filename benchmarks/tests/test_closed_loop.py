"""Tests of the other solver in the solver's closed loop, without CasADi."""

import pytest
from solverbench import loop, shooting
from solverbench.problems import LENGTH, OURS, experiment

from tetractl.control.search.optimizers.multistart import Multistart
from tetractl.core.plan import Outcome

pytestmark = pytest.mark.slow


def test_the_peer_exerts_its_first_sequence_to_the_end():
    """Regression: the peer was built with an optimiser in the place of Algorithm 2's host, and by a
    section without a number of steps."""
    spec = experiment(OURS, "controller.period=0.2")
    peer = shooting.shrinking(spec, Multistart(type="multistart", rounds=1))
    (result,) = loop.run(peer, 1)
    assert result.outcome is Outcome.SEQUENCE_COMPLETED
    assert result.steps == LENGTH  # one signal a step
