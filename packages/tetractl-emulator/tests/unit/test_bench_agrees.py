"""Tests that trials on the simulated bench and in the emulated lab have similar distributions."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import scipy
from scipy.optimize import least_squares
from testkit.emulator.bench_agreement import bench_spec, bench_trial, lab_spec, lab_trial
from testkit.emulator.virtual_lab import virtual_lab

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.poses import wrap
from tetractl.model.motion.exact import step as exact
from tetractl.plant.simulation import SimPlant

pytestmark = pytest.mark.system

TRIALS = 20
EVEN = (  # the bench of robots that are all as the spec says
    "plant.drive.gain_error=0",
    "plant.drive.radius_error=0",
    "plant.disturbances=[{type: camera-latency, mean: 0.0054}, {type: radio, delay: 0.00785}]",
)
LOSSES = 1e-3  # p of a two-sample test at which the two differ: one false alarm in a thousand


@pytest.fixture(scope="module")
def paths():
    """The trials of the emulated lab."""
    return [lab_trial(lab_spec(), trial) for trial in range(TRIALS)]


@pytest.mark.release
def test_total_errors_agree_in_distribution(paths):
    labs = [path.result for path in paths]
    sims = [bench_trial(bench_spec(), trial).result for trial in range(TRIALS)]
    assert all(result.outcome.complete for result in (*labs, *sims))
    lab_errors = np.array([result.total_error for result in labs])
    sim_errors = np.array([result.total_error for result in sims])
    assert scipy.stats.ks_2samp(lab_errors, sim_errors).pvalue > LOSSES

    def difference_of_means(a, b):
        return a.mean() - b.mean()

    logarithms = (np.log(lab_errors), np.log(sim_errors))
    assert scipy.stats.permutation_test(logarithms, difference_of_means, rng=1).pvalue > LOSSES


PREDICTED_FRAMES = 24  # 0.2 s


FRAMES_BETWEEN_STARTS = 12


@dataclass(frozen=True)
class Steered:
    """A direction [rad], and when it acts [ns]."""

    since_ns: float
    direction: float


def predicted_headings(pose, start_ns, end_ns, steered, a, bias, speed):
    """The headings (N,) by (1)-(3) at `end_ns` of robots with poses (N, 3) at `start_ns`."""
    x, y, heading = pose.T
    acting = max((entry for entry in steered if entry.since_ns <= start_ns), key=_since)
    changes = [entry for entry in steered if start_ns < entry.since_ns < end_ns]
    now_ns = start_ns
    for change in [*changes, Steered(end_ns, math.nan)]:
        toward = np.array(acting.direction) + bias
        seconds = (change.since_ns - now_ns) / SECOND
        x, y, heading = exact(x, y, heading, toward, a, speed, seconds)
        now_ns = change.since_ns
        acting = change
    return heading


def _since(entry):
    return entry.since_ns


def dead_time_s(path, setup):
    """The dead time with which, by a and biases fitted too, (1)-(3) predict headings best [s]."""
    observed_ns = np.array([step.observation.sampled_ns for step in path.steps])
    directions = [step.command.direction for step in path.steps]
    inside = [observed_ns[0] + SECOND // 4, observed_ns[-1] - SECOND // 5]
    first, last = np.searchsorted(path.mocap_ns, inside)
    starts = range(first, last, FRAMES_BETWEEN_STARTS)

    def misses(parameters):
        """Errors of headings predicted with a dead time [s], factors of a, and biases times a."""
        dead_time, a_factors, scaled_biases = np.split(parameters, [1, 4])
        since_ns = observed_ns + dead_time[0] * SECOND
        steered = [Steered(*entry) for entry in zip(since_ns, directions, strict=True)]
        a = setup.a * a_factors
        bias = scaled_biases / setup.a
        errors = []
        for start in starts:
            end = start + PREDICTED_FRAMES
            span_ns = (path.mocap_ns[start], path.mocap_ns[end])
            heading = predicted_headings(path.mocap[start], *span_ns, steered, a, bias, setup.speed)
            errors.append(wrap(heading - path.mocap[end, :, 2]))
        return np.concatenate(errors)

    guess = [0.05, *([1.0] * 3), *([0.0] * 3)]
    return least_squares(misses, guess, diff_step=1e-3, loss="soft_l1", f_scale=0.05).x[0]


@dataclass(frozen=True)
class Headings:
    """The headings (M, N) of N robots at times (M,) [s]."""

    time_s: np.ndarray
    heading: np.ndarray

    def at(self, times):
        """The headings of each robot at other times, (N, times)."""
        return np.array([np.interp(times, self.time_s, robot) for robot in self.heading.T])


def steered_headings(plant, clock, directions, period_ns):
    """Steer from a whole period on; return the headings from then on."""
    plant.open()
    began_ns = (clock.now() // period_ns + 1) * period_ns
    clock.sleep_until(began_ns)
    samples = []
    for k, direction in enumerate(directions):
        plant.observe()
        plant.send(Steer(direction))
        clock.sleep_until(began_ns + (k + 1) * period_ns)
        samples += plant.samples()
    observations = [sample.observation for sample in samples]
    times_ns = np.array([observation.sampled_ns for observation in observations])
    headings = np.array([observation.poses.heading for observation in observations])
    return Headings((times_ns - began_ns) / SECOND, headings)


def steered_alike(rate_hz, period, step, number=1):
    """Steer robots of the simulation and of the emulated lab by one sequence of directions.

    Args:
        rate_hz: Wheel commands per second [Hz], in both.
        period: The control period [s].
        step: Largest change from one direction to the next [rad].
        number: Seed of the directions. With 1, no robot comes near another one, or the edge.

    Returns:
        The headings in the simulation and those in the lab.
    """
    rng = np.random.default_rng(number)
    directions = np.cumsum(rng.uniform(-step, step, round(4 / period)))
    bench = bench_spec(*EVEN, "obstacles=[]", f"plant.drive.rate={rate_hz}").experiment
    clock = VirtualClock()
    simulated = SimPlant(bench.plant, bench.setup, clock, np.random.SeedSequence(1))
    period_ns = round(period * SECOND)
    spec = lab_spec("obstacles=[]", f"lab.actuator.rate={rate_hz}")
    with virtual_lab(None, spec=spec, seed=3) as lab:
        of_lab = steered_headings(lab.plant, lab.clock, directions, period_ns)
    return steered_headings(simulated, clock, directions, period_ns), of_lab


@pytest.mark.parametrize(
    ("rate_hz", "period", "step"), [(40, 0.2, 3.0), (40, 0.05, 0.6), (60, 0.05, 0.6)]
)
def test_one_sequence_of_directions_turns_robots_of_both_alike(rate_hz, period, step):
    of_simulation, of_lab = steered_alike(rate_hz, period, step)
    times = np.arange(0.3, 3.8, 0.01)

    def gaps(shift_s):
        return of_simulation.at(times - shift_s) - of_lab.at(times)

    assert np.abs(gaps(0.0)).max() < 0.02
    shifts_s = np.arange(-0.02, 0.02, 0.0005)
    squares = [np.square(gaps(shift_s)).sum() for shift_s in shifts_s]
    best_s = shifts_s[np.argmin(squares)]
    assert abs(best_s) < 0.003


@pytest.mark.parametrize("number", [1, 3, 4, 5])
def test_most_headings_agree_where_directions_leap(number):
    """A robot that passes the heading opposite to its direction lets small differences grow."""
    of_simulation, of_lab = steered_alike(60, 0.2, 3.0, number)
    times = np.arange(0.3, 3.8, 0.01)
    assert np.median(np.abs(of_simulation.at(times) - of_lab.at(times))) < 0.02


@pytest.mark.release
def test_the_labs_dead_time_is_what_its_parts_add_up_to(paths):
    """Regression: 0.05 s left no time for frames to be waited for and plans to be computed."""
    experiment = lab_spec().experiment
    fitted_s = [dead_time_s(path, experiment.setup) for path in paths[:6]]
    assert np.median(fitted_s) == pytest.approx(experiment.controller.dead_time, abs=0.008)
