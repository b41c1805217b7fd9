"""Signals with an intensity: prediction, search and estimate against integrals of another kind."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support import problems

from tetractl.control.acting import Acting
from tetractl.control.coordinates import decoded, encoded
from tetractl.control.cost import evaluate, foresee, predict
from tetractl.control.evaluate import compiled_costs
from tetractl.control.optimizers.cem import CrossEntropy
from tetractl.control.optimizers.mppi import Mppi
from tetractl.control.optimizers.pso import Pso
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.intensity import Intensity
from tetractl.core.plan import Limits, Search, StopReason
from tetractl.core.poses import Observation, Poses
from tetractl.core.registries import MOTIONS
from tetractl.experiment.disturbance import DelayedCommand
from tetractl.plant.direct import DirectDrive

pytestmark = pytest.mark.slow

STRENGTH = Intensity("strength", "mT", 0.5, 4.0, 2.0, 2.0)
FREQUENCY = Intensity("frequency", "rad/s", 0.0, 9.0)


def problem_of(motion, swept=False, **fields):
    found = problems.problem(problems.world(1, 3, 4, "exact", swept), **fields)
    of = FREQUENCY if motion == "rollers" else STRENGTH
    return replace(found, motion=motion, intensity=of, first_period=0.13)


def signals_of(problem, length, count=None):
    rng, of = np.random.default_rng(2), problem.intensity
    shape = (length,) if count is None else (count, length)
    return np.stack([rng.uniform(-3, 3, shape), rng.uniform(of.low, of.high, shape)], axis=-1)


def swum(problem, signals):
    """The ends of robots that turn at a B / B0, by a Runge-Kutta method."""
    state, (a, v) = problem.poses.array().T.ravel(), (problem.a, problem.speed)

    def change(_, state, u, share):
        heading = state[6:]
        turn = share * a * np.sin(u - heading)
        return np.concatenate([v * np.cos(heading), v * np.sin(heading), turn])

    for j, (u, strength) in enumerate(signals):
        until = problem.period if j else problem.first_period
        args = (u, strength / problem.intensity.reference)
        found = solve_ivp(change, (0, until), state, "DOP853", args=args, rtol=1e-12, atol=1e-10)
        state = found.y[:, -1]
    return state.reshape(3, 3).T


def test_cells_turn_in_proportion_to_the_strength_sent():
    problem = problem_of("exact")
    signals = signals_of(problem, 5)
    ends = swum(problem, signals)
    assert predict(problem, signals)[-1, :, :2] == pytest.approx(ends[:, :2], abs=1e-6)
    of, every, now = problem.intensity, np.ones(3, np.bool_), 0
    drive = DirectDrive(
        MOTIONS.load("exact"), problem.a, problem.speed, problem.poses, of.reference
    )
    for j, (u, strength) in enumerate(signals):
        drive.apply(DelayedCommand(now, now, Steer(u, strength), every))
        end = now + round((problem.period if j else problem.first_period) * SECOND)
        drive.advance(now, np.array([end]), np.ones(1, np.bool_))
        now = end
    assert drive.poses.xy == pytest.approx(ends[:, :2], abs=1e-6)


def rolled(step_out, k, u, frequency, seconds):
    """The end of a dipole that lags by p behind the rotating field, p' = f - f_i sin p, and rolls
    by k for each radian that it turns."""

    def change(_, state):
        turn = step_out * np.sin(state[0])
        return [frequency - turn, k * turn * np.cos(u), k * turn * np.sin(u)]

    lag = np.arcsin(min(1.0, frequency / step_out))  # where it settles below the step-out
    found = solve_ivp(change, (0, seconds), [lag, 0, 0], "DOP853", rtol=1e-10, atol=1e-8)
    return found.y[1:, -1]


@pytest.mark.parametrize("frequency", [2.0, 5.0, 8.5])
def test_rollers_slip_above_their_step_outs(frequency):
    """The law is a mean over turns, of which 200 s have many."""
    problem = replace(problem_of("rollers"), first_period=200.0, a=np.array([3.0, 5.1, 7.0]))
    signals = np.array([[0.7, frequency]])
    moved = predict(problem, signals)[-1, :, :2] - problem.poses.xy
    for i, step_out in enumerate(problem.a):
        k = problem.speed[i] / step_out
        end = rolled(step_out, k, 0.7, frequency, 200.0)
        assert moved[i] == pytest.approx(end, abs=2.5 * k + 1e-6)  # less than a turn


@pytest.mark.parametrize("motion", ["exact", "arc", "euler", "rollers"])
@pytest.mark.parametrize("swept", [False, True])
def test_the_compiled_cost_is_the_cost(motion, swept):
    problem = problem_of(motion, swept=swept, separation=60.0)
    signals = signals_of(problem, 6, 40)
    signals[0, :, 1] = problem.intensity.low
    found = np.stack([encoded(problem, one) for one in signals], axis=-1)
    expected = evaluate(problem, signals).total
    assert compiled_costs(problem, 40)(found) == pytest.approx(expected, rel=1e-9)
    assert expected.max() > expected.min()


def test_coordinates_are_angles_that_turn_back_at_the_bounds():
    problem = problem_of("exact")
    signals = signals_of(problem, 7)

    def as_found(coordinates):
        record = Search(7, coordinates, 0.0, np.zeros(1), 1, StopReason.TARGET)
        return decoded(problem, record).signals

    found = encoded(problem, signals)
    assert as_found(found) == pytest.approx(signals)
    assert as_found(np.concatenate([found[:7], -found[7:]])) == pytest.approx(signals)
    ends = as_found(np.concatenate([found[:7], np.full(7, np.pi)]))[:, 1]
    assert (ends == problem.intensity.high).all()
    assert encoded(problem, problem.zeros(2))[2:].tolist() == [0, 0]  # below `low` is `low`


@pytest.mark.parametrize("optimizer", [Pso(), CrossEntropy(), Mppi()], ids=lambda one: one.type)
def test_samplers_search_intensities_within_their_bounds(optimizer):
    assert optimizer.intensities
    problem = problem_of("rollers")
    problem = replace(problem, period=1.0, obstacle_weight=0.0)
    warm = signals_of(problem, 9)
    for start in (None, warm):
        found = optimizer.search(problem, 9, start, 3, Limits())
        assert found.signals.shape == (9, 2)
        assert (found.signals[:, 1] >= 0).all()
        assert (found.signals[:, 1] <= 9).all()
        seen = foresee(problem, found.signals)
        assert found.cost == pytest.approx(seen.target, rel=1e-9)
        again = optimizer.search(problem, 9, start, 3, Limits())
        assert again.signals.tobytes() == found.signals.tobytes()
    assert found.cost < foresee(problem, warm).target


def test_signals_under_way_are_part_of_the_estimate():
    problem = problem_of("exact")
    acting, every = Acting(problem, 0.3), np.ones(3, np.bool_)
    signals = [Steer(0.5, 4.0), Steer(-1.0, 1.0), Stop()]
    for k, action in enumerate(signals):
        acting.sent(Command(action, 0, (True,) * 3), round(0.2 * k * SECOND))
    at = round(
        0.4 * SECOND
    )  # the first acts from 0.3 s, the second from 0.5 s, the stop from 0.7 s
    found = acting.ahead(Observation(0, at, at, problem.poses, every))
    way = replace(problem, first_period=0.1, period=0.2)
    ends = predict(way, np.array([[0.5, 4.0], [-1.0, 1.0]]))[-1]
    assert Poses.of(ends).xy == pytest.approx(found.xy, rel=1e-12)
    hidden = Poses.of(np.full((3, 3), np.nan))  # from here on, no frame shows the robots
    later = acting.ahead(Observation(0, at + SECOND, at + SECOND, hidden, ~every))
    assert later.xy == pytest.approx(found.xy, rel=1e-12)
