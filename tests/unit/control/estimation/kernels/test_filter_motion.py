"""Tests of predicting one robot: kept rates, lags, their slopes, and long times."""

import math

import numpy as np
import pytest
from testkit.filters import (
    CASES,
    HELIX_RAD_S,
    SPEED,
    STANDS,
    A,
    bank_of,
    go_on,
    model_of,
    predicted,
)

from tetractl.control.estimation.kernels.filter_motion import STILL_PACE, SUBSTEP_S
from tetractl.control.estimation.kernels.filter_state import (
    FLOW_X,
    FLOW_Y,
    HEADING,
    HELIX_COSINE,
    HELIX_SINE,
    HOST_SWING,
    LAG,
    LN_A,
    LN_FREQUENCY,
    LN_SATURATION,
    LN_SPEED,
    PACE,
    SIDE,
    SWING,
    TURN_BIAS,
    X,
    Y,
)

pytestmark = pytest.mark.slow

WHEELS = CASES["wheels"]
LAGGING = CASES["lagging"]
T_S = 0.02
"""A short step."""


def after(case, u, seconds, cov=None, **changes):
    """The state and covariance after a time, by a model with some changes."""
    bank = bank_of(case, u, cov)
    go_on(bank, model_of(case)._replace(**changes), seconds)
    return bank.state[0, 0, 0], bank.cov[0, 0, 0]


# ---- wheels that keep a rate until the next is sent ----


def turned_by_kept_rates(case, u, kept_s, seconds):
    """The heading by Euler's method: each rate of (3) is kept for a time."""
    value = case.values.get
    a = A * math.exp(value(LN_A, 0.0))
    heading = value(HEADING, 0.0)
    for _ in range(round(seconds / kept_s)):
        sine = math.sin(u + value(TURN_BIAS, 0.0) - heading)
        heading += kept_s * a * sine * math.exp(math.copysign(value(SIDE, 0.0), sine))
    return heading


@pytest.mark.parametrize("u", [-2.0, 0.4, 2.9])
@pytest.mark.parametrize("kept_s", [0.02, 0.05])
def test_a_robot_whose_wheels_keep_a_rate_turns_as_by_eulers_method(kept_s, u):
    hold = (kept_s, kept_s**2, kept_s**3)
    z, _ = after(WHEELS, u, 0.4, hold=hold)
    expected = turned_by_kept_rates(WHEELS, u, kept_s, 0.4)
    at_once = after(WHEELS, u, 0.4)[0][HEADING]
    assert abs(z[HEADING] - expected) < 0.3 * abs(at_once - expected)


@pytest.mark.parametrize("state", [HEADING, TURN_BIAS])
@pytest.mark.parametrize("u", [-2.0, 0.4, 2.9])
def test_kept_rates_depend_on_heading_and_direction_as_their_slopes_say(u, state):
    hold = (0.05, 0.05**2, 0.05**3)
    ends = []
    for change in (-1e-5, 1e-5):
        values = WHEELS.values | {state: WHEELS.values[state] + change}
        ends.append(after(WHEELS._replace(values=values), u, T_S, hold=hold)[0])
    expected = (ends[1] - ends[0])[:3] / 2e-5
    assert column(WHEELS, u, state, hold=hold)[:3] == pytest.approx(expected, rel=1e-4, abs=1e-6)


# ---- the slopes of lagging wheels ----


def column(case, u, state, **changes):
    """The column of F = df/dz that belongs to a state, for a short step."""
    size = 1e-3
    cov = np.zeros((case.states, case.states))
    cov[state, state] = size * size
    _, moved = after(case, u, T_S, cov, **changes)
    return moved[:, state] / (size * math.sqrt(moved[state, state]))


@pytest.mark.parametrize("u", [-2.0, 0.4, 2.9])
def test_what_is_left_of_a_change_of_heading_turns_the_way_of_lagging_wheels(u):
    """The heading at rest keeps a fraction of its change, and the chord turns by the mean of the
    changes before and after. The direction does the rest."""
    value = LAGGING.values
    a = A * math.exp(value[LN_A])
    at_rest = value[HEADING] + LAGGING.host_lag_s * a * value[HOST_SWING]
    phi = u + value[TURN_BIAS] - at_rest
    decay = math.exp(-a * math.exp(math.copysign(value[SIDE], math.sin(phi))) * T_S)
    keep = decay / (math.cos(phi / 2) ** 2 + math.sin(phi / 2) ** 2 * decay**2)
    z = predicted(LAGGING, LAGGING.values, u, T_S)
    dx = z[X] - value[X] - T_S * value[FLOW_X]
    dy = z[Y] - value[Y] - T_S * value[FLOW_Y]
    turn = z[HEADING] - value[HEADING]
    turn_half = math.atan2(dy, dx) - value[HEADING]
    pose = [X, Y, HEADING]
    chord_turned = np.array([-dy, dx])

    by_heading = column(LAGGING, u, HEADING)
    assert by_heading[HEADING] == pytest.approx(keep, rel=1e-4)
    assert by_heading[[X, Y]] == pytest.approx(chord_turned * (1 + keep) / 2, rel=1e-4)
    by_u = column(LAGGING, u, TURN_BIAS)
    assert by_u[HEADING] == pytest.approx(1 - keep, rel=1e-3)
    assert by_u[[X, Y]] == pytest.approx(chord_turned * (1 - keep) / 2, rel=1e-3, abs=1e-6)
    by_a = column(LAGGING, u, LN_A)
    assert by_a[HEADING] == pytest.approx(turn, rel=1e-4)
    assert by_a[[X, Y]] == pytest.approx(chord_turned * turn_half, rel=1e-3, abs=1e-6)
    sign = math.copysign(1.0, math.sin(phi))
    assert column(LAGGING, u, SIDE)[pose] == pytest.approx(sign * by_a[pose], rel=1e-4)
    assert column(LAGGING, u, LN_SPEED)[pose] == pytest.approx([dx, dy, 0.0], rel=1e-4)
    assert column(LAGGING, u, FLOW_X)[pose] == pytest.approx([T_S, 0, 0])
    assert column(LAGGING, u, FLOW_Y)[pose] == pytest.approx([0, T_S, 0])


def test_wheels_that_saturate_turn_by_their_maximum_rate_however_uneven_they_are():
    """Then the saturation decides alone, and the side by what is its larger rate."""
    for side in (0.15, -0.15):
        values = LAGGING.values | {LN_SATURATION: math.log(0.4), SIDE: side}
        case = LAGGING._replace(values=values)
        by_saturation = column(case, 2.4, LN_SATURATION)
        by_side = column(case, 2.4, SIDE)
        assert by_saturation[HEADING] > 0
        assert by_side[:3] == pytest.approx(math.copysign(1, side) * by_saturation[:3], rel=1e-4)


# ---- wheels that stop ----


def stopped(case, seconds, pace):
    return predicted(case, case.values | {PACE: pace}, STANDS, seconds)


def test_lagging_wheels_of_a_stopped_robot_roll_on_by_their_lag():
    value = LAGGING.values
    lag_s = value[LAG]
    z = stopped(LAGGING, lag_s, value[PACE])
    left = math.exp(-1)
    assert z[PACE] == pytest.approx(value[PACE] * left)
    assert z[SWING] == pytest.approx(value[SWING] * left)
    speed = SPEED * math.exp(value[LN_SPEED])
    flow_s = lag_s
    way = math.hypot(
        z[X] - value[X] - flow_s * value[FLOW_X], z[Y] - value[Y] - flow_s * value[FLOW_Y]
    )
    assert way == pytest.approx(speed * value[PACE] * lag_s * (1 - left), rel=1e-2)
    a = A * math.exp(value[LN_A])
    turned = z[HEADING] - value[HEADING]
    assert turned == pytest.approx(a * value[SWING] * lag_s * (1 - left), rel=1e-6)


@pytest.mark.parametrize("name", ["no lag", "lagging"])
def test_a_stopped_robot_that_hardly_rolls_or_has_no_lag_stands(name):
    case = CASES[name]
    pace = 0.9 * STILL_PACE if name == "lagging" else 0.6
    z = stopped(case, 0.2, pace)
    for state in (X, Y, HEADING):
        assert z[state] == case.values[state]
    assert (z[SWING], z[PACE], z[HOST_SWING]) == (0, 0, 0)


def test_a_robot_that_still_rolls_does_not_stand_yet():
    z = stopped(LAGGING, 0.02, 1.1 * STILL_PACE)
    assert z[X] != LAGGING.values[X]
    assert z[PACE] > 0


def test_wheels_without_a_lag_follow_at_once():
    z = predicted(WHEELS, WHEELS.values, 0.4, 0.01)
    assert z[PACE] == 1
    before = predicted(WHEELS, WHEELS.values, 0.4, 0.009)
    a = A * math.exp(WHEELS.values[LN_A])
    rate = (z[HEADING] - before[HEADING]) / 0.001
    assert z[SWING] == pytest.approx(rate / a, rel=0.05)


# ---- cells, and long times ----


def test_a_helix_goes_on_while_its_cell_swims_and_stops_with_it():
    case = CASES["cell"]
    value = case.values
    angle = 0.3 * HELIX_RAD_S * math.exp(value[LN_FREQUENCY])
    z = predicted(case, value, 0.4, 0.3)
    phase = complex(value[HELIX_COSINE], value[HELIX_SINE]) * complex(
        math.cos(angle), math.sin(angle)
    )
    assert z[HELIX_COSINE] == pytest.approx(phase.real)
    assert z[HELIX_SINE] == pytest.approx(phase.imag)
    z = predicted(case, value, STANDS, 0.3)
    assert (z[HELIX_SINE], z[HELIX_COSINE]) == (value[HELIX_SINE], value[HELIX_COSINE])


def test_walks_of_a_long_time_are_as_large_as_those_of_its_parts():
    _, at_once = after(WHEELS, 0.4, 6 * SUBSTEP_S, 1e-6 * np.eye(WHEELS.states))
    bank = bank_of(WHEELS, 0.4, 1e-6 * np.eye(WHEELS.states))
    for _ in range(6):
        go_on(bank, model_of(WHEELS), SUBSTEP_S)
    assert bank.cov[0, 0, 0] == pytest.approx(at_once, rel=1e-9, abs=1e-15)


def test_an_hour_without_a_command_ends_in_reasonable_steps():
    z = predicted(WHEELS, WHEELS.values | {FLOW_X: 0.0, FLOW_Y: 0.0}, 0.4, 3600.0)
    speed = SPEED * math.exp(WHEELS.values[LN_SPEED])
    way = math.hypot(z[X] - WHEELS.values[X], z[Y] - WHEELS.values[Y])
    assert way == pytest.approx(3600 * speed, rel=1e-3)
    assert z[HEADING] == pytest.approx(0.4 + WHEELS.values[TURN_BIAS])
