"""When a direction is taken to be sent, and which commands the filter is given again."""

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.control.estimation.estimator import StateEstimator
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff, Steer, Stop

PERIOD_NS = SECOND // 20
times_ns = st.integers(0, 100 * SECOND)


def estimator(**fields):
    """An estimator of which only some fields are known."""
    made = object.__new__(StateEstimator)
    usual = {"estimate": "some", "filter": None, "_period_ns": PERIOD_NS, "_last_sent_ns": None}
    vars(made).update(usual | fields)
    return made


def frame(received_ns, age_ns=3_000_000):
    return SimpleNamespace(sampled_ns=received_ns - age_ns, received_ns=received_ns)


@given(times_ns)
def test_without_an_identified_dead_time_it_counts_from_the_exposure(received_ns):
    made = estimator(estimate=None, _last_sent_ns=received_ns)
    assert made.sending_ns(frame(received_ns)) == received_ns - 3_000_000


@given(received_ns=times_ns, since_ns=st.integers(-3 * PERIOD_NS, 3 * PERIOD_NS))
def test_a_direction_is_sent_a_period_after_the_last_one_if_that_is_soon(received_ns, since_ns):
    """Never before the frame arrived, and never more than a period and a half later."""
    due_ns = received_ns + since_ns
    made = estimator(_last_sent_ns=due_ns - PERIOD_NS)
    is_soon = 0 <= since_ns <= 1.5 * PERIOD_NS
    assert made.sending_ns(frame(received_ns)) == (due_ns if is_soon else received_ns)


def test_the_first_direction_is_sent_when_its_frame_has_arrived():
    assert estimator().sending_ns(frame(7 * SECOND)) == 7 * SECOND


def command(action, sent_s):
    return Command(action, round(sent_s * SECOND), (True,))


def after(direction, sent_s, sparse=True):
    """An estimator whose filter knows one command; a signal lasts 0.2 s, a step 0.05 s."""
    commands = SimpleNamespace(sent_s=[sent_s], directions=[direction])
    reception = SimpleNamespace(is_sparse=sparse)
    filter_bank = SimpleNamespace(reception=reception, commands=commands)
    return estimator(filter=filter_bank, problem=SimpleNamespace(period=0.2))


@pytest.mark.parametrize(
    ("action", "sent_s", "again"),
    [
        (Steer(0.5), 1.05, True),
        (Steer(0.5), 1.17, True),
        (Steer(0.5), 1.18, False),  # half a step before the period is over
        (Steer(0.5), 1.3, False),
        (Steer(0.6), 1.05, False),
        (Stop(), 1.05, False),
    ],
)
def test_over_a_sparse_radio_a_signal_counts_once_within_its_period(action, sent_s, again):
    assert after(0.5, 1.0)._is_repetition(command(action, sent_s)) == again
    assert not after(0.5, 1.0, sparse=False)._is_repetition(command(action, sent_s))


@pytest.mark.parametrize(
    ("action", "last_sent_ns"),
    [(Steer(0.1), 2 * SECOND), (Stop(), None), (FieldOff(), 1 * SECOND)],
)
def test_the_last_sending_is_that_of_a_direction_and_none_after_a_stop(action, last_sent_ns):
    given = []
    predictor = SimpleNamespace(add_command=given.append)
    made = estimator(_predictor=predictor, _last_sent_ns=SECOND, _newest_ns=9 * SECOND)
    made.add_command(command(action, 2.0))
    assert made._last_sent_ns == last_sent_ns
    assert [it.sent_ns for it in given] == [2 * SECOND]


def test_without_an_identified_dead_time_a_command_counts_from_the_newest_frame():
    given = []
    predictor = SimpleNamespace(add_command=given.append)
    made = estimator(estimate=None, _predictor=predictor, _newest_ns=9 * SECOND)
    made.add_command(command(Steer(0.1), 2.0))
    assert [it.sent_ns for it in given] == [9 * SECOND]


@pytest.mark.parametrize("sparse", [True, False])
def test_a_radio_is_sparse_if_the_filter_finds_it_so(sparse):
    assert after(0.5, 1.0, sparse).is_radio_sparse == sparse
    assert not estimator().is_radio_sparse
