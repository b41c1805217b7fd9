"""Tests of where robots will be when the next command acts: a bank's forecast, step by step."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit.filters import CASES, NO_COMMANDS, STANDS, STUCK, bank_of, model_of, predicted

from tetractl.control.estimation.kernels.bank import forecast
from tetractl.control.estimation.kernels.filter_state import (
    FINEST_STEP_S,
    FLOW_X,
    FLOW_Y,
    HEADING,
    LAG,
    PACE,
    STATES,
    SWING,
    TURN_BIAS,
    Bank,
    Forecast,
    SentCommands,
    X,
    Y,
)

pytestmark = pytest.mark.slow

TAU_S = 0.1
WATCHDOG_S = 0.25


def bank_at(case, direction=0.4, until_s=math.inf, slot=0):
    """A filter whose likeliest hypothesis is in a slot, and less likely ones of other robots."""
    bank = bank_of(case, direction, dead_time_s=TAU_S)
    slot %= bank.ln_weight.shape[2]
    bank.ln_weight[0, 0] = -9.0
    bank.ln_weight[0, 0, slot] = -0.1
    bank.direction[0, 0, slot] = direction
    bank.until_s[0, 0, slot] = until_s
    for other in set(range(len(bank.ln_weight[0, 0]))) - {slot}:
        bank.state[0, 0, other, [X, Y]] += 1000.0
    return bank


def forecast_of(case, bank, commands, sent_s, frame_s=0.0):
    room = Forecast.room_for(1)
    model = model_of(case, watchdog_s=WATCHDOG_S)
    before = bank.copied()
    forecast(bank, model, commands, np.array([frame_s]), sent_s, room)
    for name, values in bank._asdict().items():
        assert np.array_equal(values, getattr(before, name), equal_nan=True), name
    return room


def moved(case, values, u, seconds):
    """The values of the state after a time."""
    if seconds <= 0:
        return values
    z = predicted(case, values, u, seconds)
    return {state: float(z[state]) for state in range(STATES)}


def slow_forecast(case, direction, until_s, commands, end_s, follows=True):
    """The state when a command acts at `end_s`, and the direction then, event by event."""
    values = dict(case.values)
    now_s = 0.0
    acting = [
        (sent_s + TAU_S, u)
        for sent_s, u in zip(*commands, strict=True)
        if follows and sent_s + TAU_S > 0
    ]
    for acts_s, u in [*acting, (math.inf, None)]:
        leg_end_s = min(acts_s, end_s)
        drives_until_s = min(max(until_s, now_s), leg_end_s)
        values = moved(case, values, direction, drives_until_s - now_s)
        values = moved(case, values, STANDS, leg_end_s - drives_until_s)
        now_s = leg_end_s
        if acts_s > end_s:
            break
        direction, until_s = u, acts_s + WATCHDOG_S
    return values, direction if until_s > end_s else STANDS


SENDING = st.lists(
    st.tuples(st.floats(-0.3, 0.3), st.floats(-3, 3) | st.just(STANDS)), max_size=4
).map(sorted)


@settings(max_examples=30)
@given(
    sent=SENDING,
    end_s=st.floats(0.0, 0.4),
    until_s=st.sampled_from([math.inf, 0.05, -1.0]),
    slot=st.sampled_from([0, 2, STUCK]),
    name=st.sampled_from(["wheels", "saturated", "cell"]),
)
def test_all_that_was_sent_is_followed_until_the_next_command_acts(
    sent, end_s, until_s, slot, name
):
    case = CASES[name]
    times_s, directions = np.array(sent, dtype=float).reshape(-1, 2).T
    commands = SentCommands(times_s.copy(), directions.copy())
    direction = STANDS if slot == STUCK else 0.4
    bank = bank_at(case, direction, until_s, slot)
    room = forecast_of(case, bank, commands, end_s - TAU_S)
    follows = slot != STUCK  # a stuck robot follows nothing
    values, at_end = slow_forecast(case, direction, until_s, commands, end_s, follows)
    expected = [values[state] for state in (X, Y, HEADING)]
    found = [room.x[0], room.y[0], room.heading[0]]
    assert found == pytest.approx(expected, abs=1e-2)
    assert room.directions[0] == pytest.approx(at_end, nan_ok=True)
    assert room.turn_bias[0] == case.values[TURN_BIAS]
    assert room.flow[0].tolist() == [case.values[FLOW_X], case.values[FLOW_Y]]


@pytest.mark.parametrize(("late_s", "counts"), [(0.5e-9, True), (1e-6, False)])
def test_a_command_that_acts_at_the_end_itself_is_already_followed(late_s, counts):
    commands = SentCommands(np.array([0.05 + late_s]), np.array([-1.0]))
    room = forecast_of(CASES["wheels"], bank_at(CASES["wheels"]), commands, 0.05)
    assert room.directions[0] == (-1.0 if counts else 0.4)


def test_a_command_that_was_sent_to_act_before_the_frame_changes_nothing_any_more():
    """The state contains it, or the robot has missed it."""
    commands = SentCommands(np.array([-TAU_S]), np.array([-1.0]))
    room = forecast_of(CASES["wheels"], bank_at(CASES["wheels"]), commands, 0.05)
    assert room.directions[0] == 0.4


def test_a_command_cannot_act_before_the_frame():
    case = CASES["wheels"]
    room = forecast_of(case, bank_at(case), NO_COMMANDS, -5.0)
    assert (room.x[0], room.y[0]) == (case.values[X], case.values[Y])


@pytest.mark.parametrize("name", ["lagging", "longer lag"])
def test_lagging_wheels_are_foreseen_where_they_would_come_to_rest(name):
    case = CASES[name]
    room = forecast_of(case, bank_at(case), NO_COMMANDS, 0.0)
    values = moved(case, dict(case.values), 0.4, TAU_S)
    still = {FLOW_X: 0.0, FLOW_Y: 0.0}  # what carries the robot on is not foreseen
    rest = moved(case, values | still, STANDS, 20 * case.values[LAG])
    assert abs(rest[X] - values[X]) > 3
    assert (rest[SWING], rest[PACE]) == pytest.approx((0, 0), abs=1e-6)
    assert [room.x[0], room.y[0]] == pytest.approx([rest[X], rest[Y]], abs=0.3)
    assert room.heading[0] == pytest.approx(rest[HEADING], abs=1e-3)


def test_the_likeliest_filter_decides_and_the_others_spread_the_dead_time():
    """Two robots, three filters each; the frames of the second are 20 ms newer."""
    case = CASES["wheels"]
    times_s = np.array([0.1, 0.14, 0.2])
    mean = np.zeros((3, 2, STATES))
    mean[:, 0, X] = 1.0, 2.0, 3.0
    mean[:, 1, X] = 4.0, 5.0, 6.0
    bank = Bank.start(times_s, mean, np.zeros((2, case.states)), np.zeros(3, np.int64))
    bank.step_s[:] = 4 * FINEST_STEP_S
    probabilities = np.array([[0.2, 0.1], [0.5, 0.2], [0.3, 0.7]])
    bank.shared_score[:] = np.log(probabilities) - 3.0
    model = model_of(case)
    model = model._replace(
        parameters=np.repeat(model.parameters, 2, axis=0),
        noise=np.repeat(model.noise, 2, axis=1),
        walk=np.repeat(model.walk, 2, axis=1),
    )
    room = Forecast.room_for(2)
    mean_s, std_s = forecast(bank, model, NO_COMMANDS, np.array([0.0, 0.02]), 0.0, room)
    assert room.x.tolist() == [2, 6]  # robots stand
    own = probabilities.T @ times_s
    variance = np.array(
        [(p * (times_s - t) ** 2).sum() for p, t in zip(probabilities.T, own, strict=True)]
    )
    own_std = np.sqrt(variance + FINEST_STEP_S**2)
    assert room.own_dead_time == pytest.approx(own)
    assert room.own_dead_time_std == pytest.approx(own_std)
    assert mean_s == pytest.approx(own.mean())
    assert std_s == pytest.approx(math.sqrt((own_std**2).mean() + own.var()))
