"""The simulated bench and the emulated lab: the same trials, alike in distribution."""

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares
from support.bench_agreement import bench_spec, bench_trial, lab_spec, lab_trial
from support.virtual_lab import virtual_lab

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Command, Steer, Stop, Turn
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


def test_total_errors_agree_in_distribution(paths):
    labs = [path.result for path in paths]
    sims = [bench_trial(bench_spec(), trial).result for trial in range(TRIALS)]
    assert all(result.outcome.complete for result in (*labs, *sims))
    ours, theirs = ([result.total_error for result in results] for results in (labs, sims))
    assert stats.ks_2samp(ours, theirs).pvalue > LOSSES
    means = stats.permutation_test(
        (np.log(ours), np.log(theirs)), lambda a, b: a.mean() - b.mean(), rng=1
    )
    assert means.pvalue > LOSSES


def dead_time_s(path, setup):
    """The dead time, a and bias with which (1)-(3) predict a path best over 0.2 s [s]."""
    sent = [(s.observation.sampled_ns, s.command.direction) for s in path.steps]
    times = path.mocap_ns
    poses = path.mocap
    span = 24
    first, last = np.searchsorted(times, [sent[0][0] + SECOND // 4, sent[-1][0] - SECOND // 5])
    starts = range(first, last, 12)

    def misses(q):
        acting = [(when + q[0] * SECOND, u) for when, u in sent]
        a = setup.a * q[1:4]
        bias = q[4:7] / setup.a
        gathered = []
        for i in starts:
            now = times[i]
            end = times[i + span]
            x, y, heading = poses[i].T
            u = next(u for when, u in reversed(acting) if when <= now)
            for when, new in [*((w, n) for w, n in acting if now < w < end), (end, u)]:
                x, y, heading = exact(
                    x, y, heading, np.array(u) + bias, a, setup.speed, (when - now) / SECOND
                )
                now = when
                u = new
            gathered.append(
                np.remainder(heading - poses[i + span, :, 2] + np.pi, 2 * np.pi) - np.pi
            )
        return np.concatenate(gathered)

    guess = [0.05, *([1.0] * 3), *([0.0] * 3)]
    return least_squares(misses, guess, diff_step=1e-3, loss="soft_l1", f_scale=0.05).x[0]


def headings(plant, clock, directions, period_ns):
    """Steer from a whole period on; return the times since then [s] and headings (M, N)."""
    plant.open()
    began = (clock.now() // period_ns + 1) * period_ns
    clock.sleep_until(began)
    samples = []
    for k, direction in enumerate(directions):
        plant.observe()
        plant.send(Steer(direction))
        clock.sleep_until(began + (k + 1) * period_ns)
        samples += plant.samples()
    times = [sample.observation.sampled_ns - began for sample in samples]
    return np.array(times) / SECOND, np.array([s.observation.poses.heading for s in samples])


@pytest.mark.parametrize(("period", "step"), [(0.2, 3.0), (0.05, 0.6)])
def test_one_sequence_of_directions_turns_robots_of_both_alike(period, step):
    rng = np.random.default_rng(1)  # by which no robot comes near another, or the edge
    directions = np.cumsum(rng.uniform(-step, step, round(4 / period)))
    bench = bench_spec(*EVEN, "obstacles=[]").experiment
    clock = VirtualClock()
    simulated = SimPlant(bench.plant, bench.setup, clock, np.random.SeedSequence(1))
    period_ns = round(period * SECOND)
    with virtual_lab(None, spec=lab_spec("obstacles=[]"), seed=3) as lab:
        theirs = headings(lab.plant, lab.clock, directions, period_ns)
    ours = headings(simulated, clock, directions, period_ns)
    at = np.arange(0.3, 3.8, 0.01)

    def gap(shift):
        pairs = zip(ours[1].T, theirs[1].T, strict=True)
        return [np.interp(at - shift, ours[0], o) - np.interp(at, theirs[0], t) for o, t in pairs]

    assert np.abs(gap(0.0)).max() < 0.02
    shifts = np.arange(-0.02, 0.02, 0.0005)
    best = shifts[np.argmin([np.square(gap(shift)).sum() for shift in shifts])]
    assert abs(best) < 0.003


def turned_on_the_spot(plant, clock):
    """The poses before and after the robots turned on the spot for a second, from a pause."""
    plant.open()
    clock.sleep_until(clock.now() + SECOND // 10)
    plant.observe()
    plant.send(Steer(0.5))
    gathered = []
    for facing in (None, -0.8, -0.8, None):
        clock.sleep_until(clock.now() + SECOND // 2)
        gathered.append(plant.observe().poses)
        action = Stop() if facing is None else Turn(facing)
        assert plant.send(action).action == action
    clock.sleep_until(clock.now() + SECOND // 2)
    repeats = [one.action for one in plant.news() if isinstance(one, Command)]
    assert repeats.count(Turn(-0.8)) > 20
    after = plant.observe().poses
    verdict = plant.settle()
    plant.stop()
    plant.close()
    assert verdict.not_at_rest == ""
    return gathered[1], after


def test_robots_of_both_turn_on_the_spot_alike():
    bench = bench_spec(*EVEN).experiment
    clock = VirtualClock()
    simulated = SimPlant(bench.plant, bench.setup, clock, np.random.SeedSequence(1))
    with virtual_lab(None, spec=lab_spec(), seed=3) as lab:
        turned = [turned_on_the_spot(lab.plant, lab.clock), turned_on_the_spot(simulated, clock)]
    for before, after in turned:
        assert np.hypot(*(after.xy - before.xy).T).max() < 3
        off = [wrap(poses.heading + 0.8) for poses in (before, after)]
        expected = 2 * np.arctan(np.tan(off[0] / 2) * np.exp(-bench.setup.a * 1.0))  # (3), 1 s
        assert np.abs(off[1] - expected).max() < 0.1


def test_the_labs_dead_time_is_what_its_parts_add_up_to(paths):
    """Regression: 0.05 s left no time for frames to be waited for and plans to be computed."""
    experiment = lab_spec().experiment
    found = [dead_time_s(path, experiment.setup) for path in paths[:6]]
    stated = experiment.controller.dead_time
    assert np.median(found) == pytest.approx(stated, abs=0.008)
