"""Tests of each step of the fit, on made-up likelihoods, and of its intervals."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from tetractl_identify import fit
from tetractl_identify.fit import (
    BLOCK_S,
    BLOCKS_MIN,
    DEFAULT_DEAD_TIME_S,
    HALF_WIDTH_MAX,
    HEADING_MISFIT_MIN,
    UNKNOWN_S,
    _is_correlated,
    _RobotFit,
    assign_blocks,
    compute_block_widening,
)

NORMAL = 1.959964


def fitted(**values):
    """A fit of two robots in mid-course, without having run a pass."""
    made = object.__new__(_RobotFit)
    made.frames = [SimpleNamespace(lag_s=0.0)]
    made.mean = np.array(
        [[math.log(4.0), math.log(200.0), 0.1], [math.log(2.0), math.log(150.0), 0.0]]
    )
    made.std = np.array([[0.02, 0.01, 0.03], [0.05, 0.02, 0.04]])
    made.noise = np.array([[0.5, 2.0, -0.3, -1.5], [0.0, 1.0, 0.0, 1.0]])
    made.noise_std = np.full((2, 4), 0.2)
    made._noise_unit = np.array([[0.4, 3.0, 0.02, 0.05], [0.3, 2.0, 0.02, 0.05]])
    made.tau = 0.12
    made.tau_std = 0.02
    for name, value in values.items():
        setattr(made, name, value)
    return made


def pass_of(likelihood, mean, std):
    """Stands for a pass: the likelihood of each dead time, and what it found of each robot."""

    def run(frames, rows, prior, tau, *_, watched=False, blocks=()):
        return SimpleNamespace(
            likelihood=np.array([likelihood(t) for t in tau]),
            mean=np.array([mean(t) for t in tau]),
            std=np.array([std for _ in tau]),
        )

    return run


@pytest.mark.parametrize("best_s", [0.10, 0.12, 0.135])
@pytest.mark.parametrize("width_s", [0.01, 0.03])
def test_a_parabola_gives_the_likeliest_dead_time_and_its_deviation(monkeypatch, best_s, width_s):
    per_robot = lambda t: [-((t - best_s) ** 2) / (4 * width_s**2)] * 2  # noqa: E731 of two
    slopes = np.array([[3.0, 0.5, -2.0], [1.0, 0.0, 0.4]])  # per second of dead time
    at_best = fitted().mean + 0.01
    std = np.full((2, 3), 0.015)
    run = pass_of(per_robot, lambda t: at_best + slopes * (t - best_s), std)
    monkeypatch.setattr(fit, "run_filter", run)
    made = fitted()
    made.fit_motion()
    assert made.tau == pytest.approx(best_s)
    assert made.tau_std == pytest.approx(width_s)
    assert made.mean == pytest.approx(at_best)
    assert made.std == pytest.approx(np.hypot(std, slopes * width_s))


def test_a_dead_time_far_off_is_approached_and_a_flat_likelihood_is_unknown(monkeypatch):
    steady = fitted().mean
    far = pass_of(lambda t: [-((t - 5.0) ** 2) / (4 * 0.5**2)] * 2, lambda _: steady, steady * 0)
    monkeypatch.setattr(fit, "run_filter", far)
    made = fitted()
    made.fit_motion()
    assert made.tau == pytest.approx(0.12 + 4 * 0.02)  # twice the range of the parabola
    assert made.tau_std == pytest.approx(5 * 0.02)
    made.fit_motion()
    assert made.tau_std == UNKNOWN_S
    flat = pass_of(lambda _: [0.0, 0.0], lambda _: steady, steady * 0)
    monkeypatch.setattr(fit, "run_filter", flat)
    made = fitted()
    made.fit_motion()
    assert made.tau_std == pytest.approx(5 * 0.02)


@pytest.mark.parametrize(
    ("best_s", "found"),
    [(0.8, 0.8), (-0.2, -0.2), (-3.0, DEFAULT_DEAD_TIME_S), (9.0, DEFAULT_DEAD_TIME_S)],
)
def test_an_unknown_dead_time_is_searched_and_must_be_inside_the_range(monkeypatch, best_s, found):
    rates = len(fit.RATE_FACTORS)
    monkeypatch.setattr(
        fit, "run_filter", pass_of(lambda t: [-abs(t - best_s)] * rates * 2, lambda _: 0, 0)
    )
    assert fit._search_dead_time(None, np.zeros(2 * rates), None) == pytest.approx(found, abs=0.026)


@pytest.mark.parametrize("expected_s", [0.1, None, -0.3])
def test_a_fit_starts_each_robot_at_its_likeliest_rate(monkeypatch, expected_s):
    """Robot 0 turns at the first of the rates that are tried, robot 1 at the last."""
    rates = len(fit.RATE_FACTORS)
    best_s = 0.16 if expected_s is None else expected_s + 0.04
    best = [0, 2 * rates - 1]

    def run(frames, rows, prior, tau, *_):
        off = np.array([[-abs(t - best_s)] * (2 * rates) for t in tau])
        off[:, best] += 1.0
        of_row = np.arange(2 * rates)[:, None] * np.ones(3)
        assert prior.mean[:, 0] == pytest.approx(
            np.log(np.outer([4.0, 2.0], fit.RATE_FACTORS)).ravel(), abs=1e-9
        )
        return SimpleNamespace(
            likelihood=off,
            mean=np.array([of_row + 100 * t for t in tau]),
            std=np.array([of_row + 0.5 for _ in tau]),
        )

    monkeypatch.setattr(fit, "run_filter", run)
    made = fitted(frames=[SimpleNamespace(time_s=np.zeros(3)), SimpleNamespace(time_s=np.zeros(9))])
    tau, mean, std = made._find_start(expected_s)
    assert tau == pytest.approx(best_s, abs=0.03)
    assert mean[:, 0] - 100 * tau == pytest.approx(best)
    assert std[:, 0] == pytest.approx([0.5, 2 * rates - 0.5])


def test_the_likeliest_dead_time_is_that_of_the_best_rates_of_all_robots():
    likelihood = np.full((3, 2 * len(fit.RATE_FACTORS)), -9.0)
    likelihood[0, 0] = 5.0  # robot 0 alone
    likelihood[1, 1] = likelihood[1, len(fit.RATE_FACTORS)] = 3.0  # both, each at a rate of its own
    assert fit._likeliest_dead_time(SimpleNamespace(likelihood=likelihood)) == 1


def test_intervals_are_the_values_with_two_deviations_on_either_side():
    made = fitted()
    motion = made._motion_intervals()
    assert motion[0, 0] == pytest.approx(4 * np.exp([0, -NORMAL * 0.02, NORMAL * 0.02]), rel=1e-4)
    assert motion[1, 1] == pytest.approx(150 * np.exp([0, -NORMAL * 0.02, NORMAL * 0.02]), rel=1e-4)
    assert motion[0, 2] == pytest.approx([0.1, 0.1 - NORMAL * 0.03, 0.1 + NORMAL * 0.03], rel=1e-3)
    noise = made._noise_intervals()
    half = NORMAL * 0.2
    assert noise[0, 0] == pytest.approx(0.4 * np.exp([0.5, 0.5 - half, 0.5 + half]), rel=1e-4)
    assert noise[0, 1] == pytest.approx([6.0, 3.0 * (2 - half), 3.0 * (2 + half)], rel=1e-4)
    assert noise[0, 3] == pytest.approx(
        [0.05 * 1.5, 0.05 * (1.5 - half), 0.05 * (1.5 + half)], rel=1e-4
    )
    small = fitted(noise_std=np.full((2, 4), 2.0))._noise_intervals()
    assert small[1, 1, 1] == 0.0  # a walk is not below 0


def test_an_end_too_far_away_is_unknown():
    made = fitted(
        std=np.array(
            [[HALF_WIDTH_MAX[0] / NORMAL * 1.01, 0.01, HALF_WIDTH_MAX[2] / NORMAL * 0.99]] * 2
        )
    )
    motion = made._motion_intervals()
    assert motion[0, 0].tolist()[1:] == [0.0, math.inf]
    assert np.isfinite(motion[0, 2]).all()


def test_the_delay_that_a_host_assumes_widens_a_alone_and_only_with_lagging_wheels():
    lagging = fitted(frames=[SimpleNamespace(lag_s=0.0), SimpleNamespace(lag_s=0.1)])
    plain, wider = fitted()._motion_intervals(), lagging._motion_intervals()
    assert wider[0, 0, 2] > plain[0, 0, 2]
    expected = 4 * math.exp(NORMAL * math.hypot(0.02, 4 * fit.RADIO_DELAY_ERROR_S))
    assert wider[0, 0, 2] == pytest.approx(expected, rel=1e-4)
    assert (wider[:, 1:] == plain[:, 1:]).all()


@pytest.mark.parametrize(
    ("tau", "std", "ends"),
    [
        (0.12, 0.01, (0.12, 0.12 - NORMAL * 0.01, 0.12 + NORMAL * 0.01)),
        (0.01, 0.02, (0.01, 0.0, 0.01 + NORMAL * 0.02)),  # none acts before it is sent
        (-0.2, 0.01, (-0.2, -0.2 - NORMAL * 0.01, -0.2 + NORMAL * 0.01)),  # of two clocks
        (0.12, UNKNOWN_S, (0.12, 0.0, math.inf)),
    ],
)
def test_a_dead_time_is_not_below_0_if_it_may_be_above(tau, std, ends):
    interval = fitted(tau=tau, tau_std=std)._dead_time_interval()
    assert (interval.value, interval.low, interval.high) == pytest.approx(ends, rel=1e-4)


def test_residuals_that_follow_each_other_are_correlated_and_white_ones_are_not():
    rng = np.random.default_rng(8)
    white = rng.normal(0, 0.01, 600)
    smooth = np.convolve(rng.normal(0, 0.01, 604), np.ones(5) / 2, "valid")
    alternating = white * 0.2 + 0.01 * (-1.0) ** np.arange(600)
    tiny = smooth / smooth.std() * HEADING_MISFIT_MIN * 0.5
    gaps = np.where(np.arange(600) % 7 == 0, np.nan, white)
    outlier = white.copy()
    outlier[100] = 3.0
    series = np.column_stack([white, smooth, alternating, tiny, gaps, outlier])
    assert _is_correlated(series) == [False, True, True, False, False, False]


@pytest.mark.parametrize(("seconds", "count"), [(10.0, 8), (150.0, 8), (200.0, 10), (1000.0, 50)])
def test_blocks_are_as_many_as_the_time_has_and_eight_at_least(seconds, count):
    duration_s = np.random.default_rng(2).uniform(0.04, 0.06, round(seconds * 20))
    duration_s *= seconds / duration_s.sum()
    blocks = assign_blocks(duration_s)
    assert len(set(blocks)) == count == max(BLOCKS_MIN, round(seconds / BLOCK_S))
    assert (np.diff(blocks) >= 0).all()
    lengths = np.bincount(blocks, duration_s)
    assert lengths == pytest.approx(np.full(count, seconds / count), rel=0.1)


def test_equal_blocks_have_the_quantile_of_the_t_distribution():
    for blocks in (2, 8, 50):
        expected = stats.t.ppf(0.975, blocks - 1) / stats.norm.ppf(0.975)
        assert compute_block_widening(np.ones((blocks, 1))) == pytest.approx([expected], rel=1e-4)
    few = np.zeros((50, 1))
    few[:3] = 2.0  # the robot turns in three blocks only
    expected = stats.t.ppf(0.975, 2) / stats.norm.ppf(0.975)
    assert compute_block_widening(few) == pytest.approx([expected], rel=1e-4)
    negative = np.vstack([few, [[-7.0]]])
    assert compute_block_widening(negative) == pytest.approx(compute_block_widening(few))
    assert np.isfinite(compute_block_widening(np.zeros((5, 2)))).all()


# rounds


def rounds_of(monkeypatch, taus, tau_std=0.0):
    """How many rounds a fit makes whose dead time goes through these values, and then stays."""
    made = []

    class Fit:
        def __init__(self, frames, a, speed, dead_time):
            self.tau = taus[0]
            self.tau_std = tau_std

        def fit_noise(self):
            made.append("noise")

        def fit_motion(self):
            made.append("motion")
            self.tau = taus[min(len(made) // 2, len(taus) - 1)]

        def result(self, names, all_commands):
            return names, all_commands

    monkeypatch.setattr(fit, "_RobotFit", Fit)
    assert fit.fit([], ("one",), None, None, 0.1, False) == (("one",), False)
    assert made == ["noise", "motion"] * (len(made) // 2)
    return len(made) // 2


def test_a_fit_makes_its_rounds_and_no_more_if_the_dead_time_has_settled(monkeypatch):
    assert rounds_of(monkeypatch, [0.1]) == fit.ROUNDS_MIN
    early = [0.1, 0.2, 0.15, 0.15, 0.15, 0.15, 0.15]
    assert rounds_of(monkeypatch, early) == fit.ROUNDS_MIN


def test_a_fit_goes_on_until_its_dead_time_has_settled(monkeypatch):
    steps = [0.1 + 0.01 * k for k in range(10)]
    assert rounds_of(monkeypatch, steps) == 10
    falling = [0.1 - 0.01 * k for k in range(10)]
    assert rounds_of(monkeypatch, falling) == 10
    assert rounds_of(monkeypatch, [0.1 + 0.01 * k for k in range(50)]) == fit.ROUNDS_MAX


@pytest.mark.parametrize(("step_s", "rounds"), [(0.0099, fit.ROUNDS_MIN), (0.0101, fit.ROUNDS_MAX)])
def test_half_a_deviation_is_little_enough(monkeypatch, step_s, rounds):
    steps = [step_s * k for k in range(50)]
    assert rounds_of(monkeypatch, steps, tau_std=0.02) == rounds


# widening


def widened(monkeypatch, slopes, curvatures):
    """A fit after its deviations were widened by the slopes and curvatures of blocks (B, N, 8)."""
    made = fitted()
    parts = (0 * slopes, slopes - curvatures / 2, -slopes - curvatures / 2)
    monkeypatch.setattr(_RobotFit, "_compute_block_likelihoods", lambda self: parts)
    made._widen_deviations()
    return made


BLOCKS = 40
EVEN = np.ones((BLOCKS, 2, 8))


def spread(std):
    """Slopes of blocks with this deviation: alternating, so that none is an outlier."""
    sign = np.where(np.arange(BLOCKS) % 2 == 0, 1.0, -1.0)
    return std * sign[:, None, None] * np.ones((1, 2, 8)) * math.sqrt((BLOCKS - 1) / BLOCKS)


def test_blocks_that_differ_as_expected_widen_only_by_their_number(monkeypatch):
    made = widened(monkeypatch, spread(1.0), EVEN)
    wider = stats.t.ppf(0.975, BLOCKS - 1) / stats.norm.ppf(0.975)
    assert made.std == pytest.approx(fitted().std * wider, rel=1e-4)
    assert made.noise_std == pytest.approx(fitted().noise_std * wider, rel=1e-4)


@pytest.mark.parametrize("factor", [2.0, 5.0])
def test_blocks_that_differ_more_widen_by_as_much(monkeypatch, factor):
    made = widened(monkeypatch, spread(factor), EVEN)
    wider = factor * stats.t.ppf(0.975, BLOCKS - 1) / stats.norm.ppf(0.975)
    assert made.std == pytest.approx(fitted().std * wider, rel=1e-4)
    # both robots share the dead time: their slopes add up, as their curvatures do
    assert made.tau_std == pytest.approx(fitted().tau_std * wider * math.sqrt(2), rel=1e-4)


def test_blocks_that_differ_less_narrow_nothing(monkeypatch):
    made = widened(monkeypatch, spread(0.1), EVEN)
    assert (made.std == fitted().std).all()
    assert (made.noise_std == fitted().noise_std).all()
    assert made.tau_std == fitted().tau_std


def test_each_parameter_is_widened_by_its_own_blocks(monkeypatch):
    slopes = spread(0.1)
    slopes[:, 1, 5] *= 100.0
    made = widened(monkeypatch, slopes, EVEN)
    changed = made.std / fitted().std
    assert changed[1, 1] > 5
    changed[1, 1] = 1.0
    assert changed == pytest.approx(np.ones((2, 3)))


# the result


def test_a_result_has_the_values_of_each_robot_and_its_misfits(monkeypatch):
    rng = np.random.default_rng(1)
    white = rng.normal(0, 0.01, 600)
    smooth = np.convolve(rng.normal(0, 0.01, 604), np.ones(5) / 2, "valid")
    passed = SimpleNamespace(
        heading_residuals=np.column_stack([white, smooth]), lost=np.array([2.4, 0.6])
    )
    monkeypatch.setattr(_RobotFit, "fit_motion", lambda self, watched=False: passed)
    monkeypatch.setattr(_RobotFit, "_widen_deviations", lambda self: None)
    monkeypatch.setattr(fit, "compute_speed_wander", lambda frames: np.array([0.2, 0.01]))
    monkeypatch.setattr(fit, "count_driving_intervals", lambda frames: np.array([100, 90]))
    dead_time, (one, two) = fitted().result(("one", "two"), True)
    assert dead_time.value == 0.12
    assert (one.name, two.name) == ("one", "two")
    assert (one.a.value, two.a.value) == pytest.approx((4.0, 2.0))
    assert (one.speed.value, two.speed.value) == pytest.approx((200.0, 150.0))
    assert (one.heading_bias.value, two.heading_bias.value) == (0.1, 0.0)
    assert (one.lost, two.lost) == (2, 1)
    assert (one.intervals, two.intervals) == (100, 90)
    assert one.misfits == (fit.SPEED_MISFIT,)
    assert two.misfits == (fit.HEADING_MISFIT,)
    assert one.position_noise.value == pytest.approx(0.4 * math.exp(0.5))
    assert one.heading_noise.value == pytest.approx(0.02 * math.exp(-0.3))
    assert one.heading_walk.value == pytest.approx(0.05 * 1.5)
    _, (_, unknown) = fitted().result(("one", "two"), False)
    assert unknown.misfits == ()


def test_a_speed_wanders_only_beyond_what_noise_of_positions_makes(monkeypatch):
    """Two positions a second apart show a speed with the noise of both."""
    passed = SimpleNamespace(heading_residuals=np.zeros((9, 2)), lost=np.zeros(2))
    monkeypatch.setattr(_RobotFit, "fit_motion", lambda self, watched=False: passed)
    monkeypatch.setattr(_RobotFit, "_widen_deviations", lambda self: None)
    monkeypatch.setattr(fit, "count_driving_intervals", lambda frames: np.array([100, 90]))
    noisy = np.array([[math.log(20.0 / 0.4), 1.0, 0, 1.0], [0.0, 1.0, 0, 1.0]])  # 20 mm
    limit = 2 * math.sqrt(2) * 20.0 / 200.0
    for wander, wanders in ((limit * 0.99, False), (limit * 1.01, True)):
        monkeypatch.setattr(
            fit, "compute_speed_wander", lambda frames, w=wander: np.array([w, 0.0])
        )
        _, (one, two) = fitted(noise=noisy).result(("one", "two"), True)
        assert (one.misfits == (fit.SPEED_MISFIT,)) is wanders
        assert two.misfits == ()


def test_a_fit_starts_from_the_measured_noise_in_units_of_the_usual_one(monkeypatch):
    """A robot of twice the speed has twice the usual noise and walk of positions."""
    speed = np.array([100.0, 200.0])
    monkeypatch.setattr(fit, "estimate_position_noise", lambda frames: np.array([0.0, 1e3]))
    monkeypatch.setattr(_RobotFit, "_find_start", lambda self, tau: (tau, self.mean, self.std))
    made = _RobotFit([], np.array([4.0, 2.0]), speed, 0.1)
    position, walk, heading, heading_walk = made._noise_unit.T
    assert position == pytest.approx(fit.POSITION_NOISE_S * speed)
    assert walk == pytest.approx(fit.SLIP * speed)
    assert heading.tolist() == [fit.HEADING_NOISE] * 2
    assert heading_walk.tolist() == [fit.WALK] * 2
    assert made.noise[0].tolist() == [0.0, 1.0, 0.0, 1.0]  # never less than usual
    assert made.noise[1, 0] == pytest.approx(math.log(1e3 / (fit.POSITION_NOISE_S * 200.0)))
    assert np.exp(made.mean[:, :2]) == pytest.approx(np.array([[4.0, 100.0], [2.0, 200.0]]))
    assert made.mean[:, 2].tolist() == [0.0, 0.0]
