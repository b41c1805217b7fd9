"""The readable doubts about commands, and their compiled twin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import problems

from tetractl.control import losses as readable
from tetractl.control.delay import Predictor
from tetractl.control.kernels import losses as compiled
from tetractl.core.clock import SECOND
from tetractl.core.poses import Observation, Poses
from tetractl.experiment.kinds import MOTIONS


def doubts(problem, frames, predictor, last, bias):
    """What both find, (H, N) each."""
    motion = MOTIONS.load(problem.motion)
    lanes = motion.lanes(problem.a, problem.period)
    lanes = lanes.of(problem.a, problem.speed, problem.period)
    found = np.repeat(readable.DOUBT[:, None], len(problem.a), axis=1)
    slow, fast = found.copy(), found.copy()
    readable.add_doubts(slow, problem, frames, predictor, last, bias)
    compiled.add_doubts(fast, problem, frames, predictor, last, bias, lanes)
    return slow, fast


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    robots=st.sampled_from([1, 2, 3, 14]),
    model=st.sampled_from(["euler", "arc", "exact"]),
    count=st.integers(2, 7),
    dead_time=st.sampled_from([0.0, 0.05, 0.2, 0.4]),
    seen=st.sampled_from([0.5, 1.0]),
    begun=st.booleans(),
)
def test_the_compiled_twin_doubts_as_much(seed, robots, model, count, dead_time, seen, begun):
    """Robots with random headings, so that each hypothesis is far off; some commands were lost
    before, and some are still on their way."""
    rng = np.random.default_rng(seed)
    problem = problems.problem(problems.world(seed, robots, model=model))
    predictor = Predictor(dead_time, robots)
    if begun:
        predictor.before = rng.uniform(-3, 3, robots)
    times = np.cumsum(rng.integers(SECOND // 20, SECOND // 3, count))
    for sent_ns in times:
        predictor.sent(int(sent_ns), float(rng.uniform(-3, 3)))
        predictor.recent[-1].arrived = rng.random(robots) < 0.7
    believed = [sent.arrived.copy() for sent in predictor.recent]
    last = int(rng.integers(1, count))
    began = times[last - 1] + predictor.delay_ns
    frames = [
        Observation(k, int(ns), int(ns), Poses.of(rng.uniform(-4, 4, (robots, 3))), tracked)
        for k, ns in enumerate(began - 1 + np.cumsum(rng.integers(1, SECOND // 3, 5)))
        if (tracked := rng.random(robots) < seen).size
    ]
    bias = rng.normal(0, 0.1, robots)
    slow, fast = doubts(problem, frames, predictor, last, bias)
    assert fast == pytest.approx(slow, rel=1e-9)
    for sent, arrived in zip(predictor.recent, believed, strict=True):
        assert np.array_equal(sent.arrived, arrived)  # neither leaves its hypotheses behind


def test_what_arrived_is_doubted_least():
    """Of two commands the second is lost at the second robot."""
    problem = problems.problem(problems.world(1, 2, model="exact"))
    predictor, headings = Predictor(0.1, 2), [np.zeros(2)]
    for k, u in enumerate((1.0, -1.0)):
        predictor.sent(k * SECOND // 5, u)
    predictor.recent[1].arrived[1] = False
    turn = MOTIONS.load("exact").headings
    for towards in ([1.0, 1.0], [-1.0, 1.0]):
        headings.append(turn(headings[-1], np.array(towards), problem.a, 0.2))
    frames = [
        Observation(k, ns, ns, Poses(h, h, h), np.ones(2, dtype=np.bool_))
        for k, (ns, h) in enumerate(
            zip((SECOND // 10, 3 * SECOND // 10, SECOND // 2), headings, strict=True)
        )
    ]
    for found in doubts(problem, frames, predictor, 1, np.zeros(2)):
        best = np.argmin(found, axis=0)
        assert [readable.HYPOTHESES[h] for h in best] == [(True, True), (True, False)]
