"""Tests of one filter step against integrated equations, numerical slopes and textbook formulas."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import multivariate_normal
from testkit.filters import (
    CASES,
    NOISE,
    SPEED,
    STANDS,
    STICKS,
    STUCK,
    A,
    bank_of,
    expected_pose,
    go_on,
    model_of,
    predicted,
    some_covariance,
)

from tetractl.control.estimation.kernels.filter import (
    LEAST_LN_WEIGHT,
    LOST_TRACK_S,
    SCALE_MEMORY,
)
from tetractl.control.estimation.kernels.filter_state import (
    FLOW_X,
    FLOW_Y,
    FOLLOWS,
    GATE,
    HEADING,
    HEADINGS,
    HELIX_COSINE,
    HELIX_SINE,
    HOST_SWING,
    LAG,
    LN_A,
    LN_FREQUENCY,
    LN_SATURATION,
    LN_SPEED,
    LOG_FOLLOWS,
    LOSS_PROBABILITY,
    PACE,
    POSITIONS,
    SIDE,
    STATES,
    SWING,
    TURN_BIAS,
    SentCommands,
    X,
    Y,
)

pytestmark = pytest.mark.slow

# ---- predict ----


def velocity(case, u):
    """The right-hand side of the equations in the head of `filter_state`."""
    value = case.values.get

    def by_time(_, z):
        heading, p, q, swing, pace, host_swing = z[2:]
        a = A * math.exp(value(LN_A, 0.0))
        speed = SPEED * math.exp(value(LN_SPEED, 0.0))
        side = value(SIDE, 0.0)
        fastest = math.exp(abs(side) + value(LN_SATURATION, 0.0))
        lag_s = value(LAG, 0.0)
        at_rest = heading + case.host_lag_s * a * host_swing  # as the host foresees it
        sine = math.sin(u + value(TURN_BIAS, 0.0) - at_rest)
        wish = np.clip(sine * math.exp(side if sine >= 0 else -side), -fastest, fastest)
        w = case.helix_rad_s * math.exp(value(LN_FREQUENCY, 0.0))
        swing_rate = pace_rate = host_swing_rate = 0.0
        if lag_s == 0:
            swing, pace = wish, 1.0
        else:
            swing_rate = (wish - swing) / lag_s
            pace_rate = (1 - pace) / lag_s
        if case.host_lag_s > 0:
            host_swing_rate = (wish - host_swing) / case.host_lag_s
        return [
            speed * pace * math.cos(heading) + value(FLOW_X, 0.0),
            speed * pace * math.sin(heading) + value(FLOW_Y, 0.0),
            a * swing,
            w * q,
            -w * p,
            swing_rate,
            pace_rate,
            host_swing_rate,
        ]

    return by_time


MOVING = [X, Y, HEADING, HELIX_SINE, HELIX_COSINE, SWING, PACE, HOST_SWING]


@pytest.mark.parametrize("u", [-2.0, 0.4, 2.9])
@pytest.mark.parametrize("name", CASES)
def test_a_robot_moves_by_its_equations(name, u):
    case = CASES[name]
    start = [case.values.get(state, 0.0) for state in MOVING]
    wanted = solve_ivp(velocity(case, u), (0, 0.3), start, rtol=1e-9, atol=1e-9, max_step=1e-3)
    moved = predicted(case, case.values, u, 0.3)[MOVING]
    assert moved[:2] == pytest.approx(wanted.y[:2, -1], abs=0.5)  # of 85 mm
    knows_lag = case.values.get(LAG, 0.0) == case.host_lag_s
    assert moved[2] == pytest.approx(wanted.y[2, -1], abs=3e-3 if knows_lag else 8e-3)
    assert moved[3:5] == pytest.approx(wanted.y[3:5, -1], abs=0.01)
    if case.values.get(LAG, 0.0) > 0:  # wheels without a lag have none of these
        assert moved[5:7] == pytest.approx(wanted.y[5:7, -1], abs=0.01)
        if case.host_lag_s > 0:
            assert moved[7] == pytest.approx(wanted.y[7, -1], abs=0.01)


def slopes(case, u, seconds):
    """F by central differences of the predicted state (n, n)."""
    columns = []
    for state in range(case.states):
        ends = []
        for change in (-1e-5, 1e-5):
            values = case.values | {state: case.values.get(state, 0.0) + change}
            ends.append(predicted(case, values, u, seconds)[: case.states])
        columns.append((ends[1] - ends[0]) / 2e-5)
    return np.array(columns).T


@pytest.mark.parametrize("u", [-2.0, 0.4, 2.9])
@pytest.mark.parametrize(
    ("name", "seconds", "tolerance"),
    [("wheels", 0.3, 1e-5), ("cell", 0.3, 1e-5), ("saturated", 0.3, 0.02), ("lagging", 1.2, 0.3)],
)
def test_the_covariance_follows_the_slopes_of_the_motion(name, seconds, tolerance, u):
    """P after a time is F P F', where F are the slopes of the state then by the state before.

    Those of lagging wheels are approximate, as their swing and pace have no variance.
    """
    case = CASES[name]
    before = some_covariance(case.states)
    bank = bank_of(case, u, before)
    go_on(bank, model_of(case), seconds)
    f = slopes(case, u, seconds)
    wanted = f @ before @ f.T
    sizes = np.sqrt(np.diag(wanted))
    after = bank.cov[0, 0, 0]
    assert after / np.outer(sizes, sizes) == pytest.approx(
        wanted / np.outer(sizes, sizes), abs=tolerance
    )
    assert np.array_equal(after, after.T)


def test_random_walks_add_their_variance_where_the_robot_drives():
    case = CASES["wheels"]
    driving = bank_of(case, 0.4)
    driving.noise_scale[0, 0] = 2.0, 3.0
    go_on(driving, model_of(case, walk=0.2), 0.02)
    wanted = np.full(case.states, 0.2**2 * 0.02)
    wanted[[X, Y]] *= 2
    wanted[HEADING] *= 3
    assert np.diag(driving.cov[0, 0, 0]) == pytest.approx(wanted)
    standing = bank_of(case, STANDS)
    go_on(standing, model_of(case, walk=0.2), 0.02)
    assert not standing.cov[0, 0, 0].any()


def test_a_watchdog_stops_a_robot():
    case = CASES["wheels"]
    stopped = bank_of(case, 0.4)
    stopped.until_s[:] = 0.15
    go_on(stopped, model_of(case), 0.3)
    wanted = predicted(case, case.values, 0.4, 0.15)
    assert stopped.state[0, 0, 0, :SWING] == pytest.approx(wanted[:SWING])
    assert stopped.state[0, 0, 0, PACE] == 0


def test_the_heading_of_a_robot_that_drives_against_its_direction_stays_a_covariance():
    """Linearised, its variance would grow without bound."""
    case = CASES["wheels"]
    heading = case.values[HEADING]
    against = heading + math.pi - case.values[TURN_BIAS]
    bank = bank_of(case, against, some_covariance(case.states))
    go_on(bank, model_of(case, walk=0.1), 20.0)
    cov = bank.cov[0, 0, 0]
    assert cov[HEADING, HEADING] == pytest.approx(math.pi**2 / 3)
    assert np.linalg.eigvalsh(cov).min() > -1e-9 * np.trace(cov)


# ---- update ----


def measured_slopes(case, z):
    """H by central differences (3, n)."""
    columns = []
    for state in range(case.states):
        change = np.zeros(STATES)
        change[state] = 1e-6
        column = expected_pose(case, z + change) - expected_pose(case, z - change)
        columns.append(column / 2e-6)
    return np.array(columns).T


@pytest.mark.parametrize("scale", [1.0, 2.5])
@pytest.mark.parametrize("name", ["wheels", "cell"])
def test_a_pose_updates_a_robot_by_the_kalman_filter(name, scale):
    """K = P H' (H P H' + R)^-1 as printed in textbooks, with all numbers at once."""
    case = CASES[name]
    before = some_covariance(case.states)
    bank = bank_of(case, STANDS, before)
    bank.noise_scale[:] = scale
    z = bank.state[0, 0, 0].copy()
    off = np.array([4.0, -6.0, 0.05])
    turned = [0, 0, math.tau]  # a camera's headings are wrapped
    ln_likelihood = go_on(bank, model_of(case), 0.02, expected_pose(case, z) + off + turned)

    h = measured_slopes(case, z)
    s = h @ before @ h.T + np.diag(NOISE[:, 0] ** 2) * scale
    gain = before @ h.T @ np.linalg.inv(s)
    n = case.states
    assert bank.state[0, 0, 0, :n] == pytest.approx(z[:n] + gain @ off, abs=1e-6)
    assert bank.cov[0, 0, 0] == pytest.approx(before - gain @ h @ before, abs=1e-6)
    ln_density = multivariate_normal(cov=s).logpdf(off) + 1.5 * math.log(math.tau)
    assert ln_likelihood == pytest.approx(ln_density)


def test_a_pose_after_a_long_time_without_one_leaves_a_covariance():
    """P is ten orders larger than R then, and 1 - K H would leave rounding errors alone."""
    case = CASES["wheels"]
    before = some_covariance(case.states) * 1e10
    bank = bank_of(case, STANDS, before)
    bank.noise_scale[:] = 1e-3
    go_on(bank, model_of(case), 0.02, expected_pose(case, bank.state[0, 0, 0]))
    assert np.linalg.eigvalsh(bank.cov[0, 0, 0]).min() > -1e-12 * np.trace(before)
    variances = np.diag(bank.cov[0, 0, 0])
    assert variances[[X, Y]] == pytest.approx(NOISE[:2, 0] ** 2 * 1e-3, rel=1e-3)


@pytest.mark.parametrize("pose", [[5000.0, 20.0, 0.5], [math.nan, 20.0, 0.5]])
def test_an_outlier_changes_no_state_until_no_pose_has_fitted_for_a_while(pose):
    case = CASES["wheels"]
    bank = bank_of(case, STANDS, some_covariance(case.states))
    z = bank.state[0, 0, 0].copy()
    cov = bank.cov[0, 0, 0].copy()
    go_on(bank, model_of(case), 0.02, np.array(pose))
    assert np.array_equal(bank.state[0, 0, 0], z)
    assert np.array_equal(bank.cov[0, 0, 0], cov)
    assert np.array_equal(bank.noise_scale[0, 0], [1, 1])
    go_on(bank, model_of(case), LOST_TRACK_S, np.array(pose))
    assert np.array_equal(bank.state[0, 0, 0, [X, Y]], pose[:2], equal_nan=True)


def test_the_noise_follows_what_is_measured():
    """By an average over SCALE_MEMORY frames of squared innovations, of which 4 counts at most."""
    case = CASES["wheels"]
    cov = np.diag(np.full(case.states, 1e-9))
    for size in (0.0, 1.0, 3.0):
        bank = bank_of(case, STANDS, cov)
        z = bank.state[0, 0, 0].copy()
        go_on(bank, model_of(case), 0.02, expected_pose(case, z) + size * NOISE[:, 0])
        wanted = 1 + (min(size**2, 4.0) / 0.8 - 1) / SCALE_MEMORY
        assert bank.noise_scale[0, 0, POSITIONS] == pytest.approx(wanted, rel=1e-6)
        assert bank.noise_scale[0, 0, HEADINGS] == pytest.approx(wanted, rel=1e-6)


def test_hypotheses_are_weighed_by_bayes_rule():
    case = CASES["wheels"]
    cov = some_covariance(case.states)
    bank = bank_of(case, STANDS, cov)
    probabilities = np.array([0.5, 0.3, 0.2])
    bank.ln_weight[0, 0, :3] = np.log(probabilities)
    bank.state[0, 0, 1, X] += 8.0
    bank.state[0, 0, 2, X] += 4000.0  # too far away to be it
    z = bank.state[0, 0].copy()
    pose = expected_pose(case, z[0]) + np.array([3.0, 2.0, 0.0])
    ln_likelihood = go_on(bank, model_of(case), 0.02, pose)
    h = measured_slopes(case, z[0])
    s = h @ cov @ h.T + np.diag(NOISE[:, 0] ** 2)
    factor = math.tau**1.5
    likelihoods = [
        factor * multivariate_normal(cov=s).pdf(pose - expected_pose(case, z[slot]))
        for slot in range(2)
    ]
    at_gate = math.exp(-GATE / 2) / math.sqrt(np.prod(np.diag(s)))
    evidence = probabilities * [*likelihoods, at_gate]
    assert ln_likelihood == pytest.approx(math.log(evidence.sum()))
    wanted = np.maximum(np.log(evidence / evidence.sum()), LEAST_LN_WEIGHT)
    assert bank.ln_weight[0, 0, :3] == pytest.approx(wanted)


# ---- commands ----

LOST = LOSS_PROBABILITY
HEARD = 1 - LOST


def after_commands(*directions, follows=FOLLOWS, step_s=0.0, drives=0.4):
    """The hypotheses of a robot after commands that act 0.1 ms after each other, in a frame that
    shows no pose: probabilities by direction, and the bank."""
    case = CASES["wheels"]
    dead_time_s = 0.1
    bank = bank_of(case, drives, 1e-4 * np.eye(case.states), dead_time_s, follows)
    model = model_of(case, branch_all=follows > FOLLOWS)
    sent_s = -dead_time_s + 1e-4 * np.arange(1, len(directions) + 1)
    commands = SentCommands(sent_s, np.array(directions))
    go_on(bank, model, 1e-4 * (len(directions) + 1), None, commands, step_s)
    return bank


def probability_of(bank, direction):
    """The probability that the robot follows a direction, by hypotheses that drive."""
    same = bank.direction[0, 0, :STUCK] == direction
    return np.exp(bank.ln_weight[0, 0, :STUCK][same]).sum()


@pytest.mark.parametrize("follows", [FOLLOWS, LOG_FOLLOWS])
def test_a_command_was_received_or_missed(follows):
    bank = after_commands(1.0, follows=follows)
    assert probability_of(bank, 1.0) == pytest.approx(HEARD)
    assert probability_of(bank, 0.4) == pytest.approx(LOST)


@pytest.mark.parametrize("follows", [FOLLOWS, LOG_FOLLOWS])
def test_of_two_commands_the_robot_may_have_missed_one_or_both(follows):
    bank = after_commands(1.0, -1.0, follows=follows)
    if follows == LOG_FOLLOWS:  # whether it heard the first or not makes no difference then
        assert probability_of(bank, -1.0) == pytest.approx(HEARD)
    else:  # the likeliest hypothesis alone is thought to hear
        assert probability_of(bank, -1.0) == pytest.approx(HEARD**2)
    assert probability_of(bank, 1.0) == pytest.approx(HEARD * LOST)
    assert probability_of(bank, 0.4) == pytest.approx(LOST**2)


@pytest.mark.parametrize("follows", [FOLLOWS, LOG_FOLLOWS])
def test_a_command_to_go_on_makes_no_hypothesis_more(follows):
    bank = after_commands(0.4, 0.4, follows=follows)
    used = bank.ln_weight[0, 0, :STUCK] > -math.inf
    assert used.sum() == 1
    assert (bank.direction[0, 0, :STUCK][used] == 0.4).all()


@pytest.mark.parametrize("follows", [FOLLOWS, LOG_FOLLOWS])
def test_more_commands_than_slots_leave_the_likeliest(follows):
    directions = 0.1 * np.arange(1, 11)
    bank = after_commands(*directions, follows=follows)
    assert set(bank.direction[0, 0, :STUCK]) == set(directions[-follows:])
    assert np.argmax(bank.ln_weight[0, 0]) == np.argmax(bank.direction[0, 0, :STUCK])


def test_a_change_of_direction_is_as_uncertain_as_its_time():
    """The heading by the change of the turning rate, over a time spread evenly over the step; the
    place by the speed, if the robot starts or stops."""
    step_s = 0.02
    value = CASES["wheels"].values
    a = A * math.exp(value[LN_A])

    def turning_rate(u):
        sine = math.sin(u + value[TURN_BIAS] - value[HEADING])
        return a * sine * math.exp(math.copysign(value[SIDE], sine))

    def added(before, after):
        sharp = after_commands(after, drives=before)
        blurred = after_commands(after, drives=before, step_s=step_s)
        slot = np.argmax(blurred.ln_weight[0, 0])
        return np.diag(blurred.cov[0, 0, slot] - sharp.cov[0, 0, slot])

    turned = step_s**2 / 12 * (turning_rate(-1.0) - turning_rate(1.0)) ** 2
    assert added(1.0, -1.0)[HEADING] == pytest.approx(turned, rel=0.02)
    assert added(1.0, -1.0)[X] < 0.1
    speed = SPEED * math.exp(value[LN_SPEED])
    stopped = added(1.0, STANDS)
    assert stopped[[X, Y]] == pytest.approx((step_s * speed) ** 2 / 12, rel=1e-6)
    assert stopped[HEADING] == pytest.approx(step_s**2 / 12 * turning_rate(1.0) ** 2, rel=0.02)


# ---- stuck ----


def test_a_robot_that_drives_may_get_stuck():
    case = CASES["wheels"]
    bank = bank_of(case, 0.4)
    go_on(bank, model_of(case), 0.03)
    assert bank.ln_weight[0, 0, STUCK] == pytest.approx(math.log(0.03 / STICKS.every_s))
    assert np.isnan(bank.direction[0, 0, STUCK])
    assert np.array_equal(bank.state[0, 0, STUCK], bank.state[0, 0, 0])


def test_a_robot_that_stands_is_not_stuck():
    case = CASES["wheels"]
    bank = bank_of(case, STANDS)
    bank.ln_weight[0, 0, STUCK] = -1.0
    go_on(bank, model_of(case), 0.03)
    assert bank.ln_weight[0, 0, STUCK] == -math.inf


def test_a_stuck_robot_stands_strays_and_may_come_free():
    case = CASES["wheels"]
    bank = bank_of(case, 0.4)
    bank.ln_weight[0, 0, [0, STUCK]] = -20.0, 0.0
    z = bank.state[0, 0, STUCK].copy()
    go_on(bank, model_of(case), 0.03)
    assert np.array_equal(bank.state[0, 0, STUCK], z)
    grown = np.diag(bank.cov[0, 0, STUCK])
    assert grown[:3] == pytest.approx([108.0, 108.0, 0.03])  # strays^2 t, turns^2 t
    assert not grown[3:].any()
    free = math.log(0.03 / STICKS.for_s)
    assert bank.ln_weight[0, 0, 0] == pytest.approx(free)
    assert np.array_equal(bank.state[0, 0, 0], z)
    assert bank.ln_weight[0, 0, STUCK] == pytest.approx(math.log(1 - 0.03 / STICKS.for_s))
