"""The readable fit of dead time and motion, and its compiled twin."""

import math
from dataclasses import fields, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tetractl.control import identify as readable
from tetractl.control.identify import Directions, Intervals, Prior
from tetractl.control.kernels import identify as compiled
from tetractl.control.kernels import turns
from tetractl.core.poses import Floats
from tetractl.experiment.kinds import MOTIONS
from tetractl.model.motion.base import Motion
from tetractl.model.motion.exact import ExactLanes, step

PERIOD = 0.2
SCALES = {"a": 1.0, "speed": 100.0}


class PlainLanes(NamedTuple):
    """The exact motion as a package may bring it, without a `turn`."""

    rows: Floats
    pieces: int = 1
    size = ExactLanes.size
    of = classmethod(ExactLanes.of.__func__)
    advance = staticmethod(ExactLanes.advance)
    differentiate = staticmethod(ExactLanes.differentiate)


PLAIN = Motion("plain", step, step, lambda a, longest: PlainLanes)


def constants(motion, prior):
    return motion.lanes(prior.a, PERIOD).of(prior.a, prior.speed, PERIOD)


def drive(motion, seed, robots, count, tau, noise=0.03, lost=0.0, unseen=0.0):
    """K intervals of robots in random directions, irregular in time, and their prior."""
    rng = np.random.default_rng(seed)
    a, speed = rng.uniform(2, 8, robots), rng.uniform(50, 250, robots)
    when = np.cumsum(rng.choice([0.1, PERIOD, PERIOD, 0.31], count + 2))
    u = rng.uniform(-2, 2, len(when))
    came = rng.random((len(when), robots)) >= lost
    spans = rng.choice([0.04, PERIOD, PERIOD, 0.7], count)
    ends = when[1] + np.concatenate([[0.0], np.cumsum(spans)])
    bias, true_a = rng.normal(0, 0.05, robots), a * rng.uniform(0.7, 1.4, robots)
    heading, headings = rng.uniform(-3, 3, robots), []
    for since, until in pairwise(ends):
        headings.append(heading)
        cuts = [since, *(t for t in when + tau if since < t < until), until]
        for begin, end in pairwise(cuts):
            acting = np.maximum(np.searchsorted(when + tau, begin, "right") - 1, 0)
            towards = np.empty(robots)
            for i in range(robots):
                heard = [c for c in range(acting + 1) if came[c, i]] or [0]
                towards[i] = u[heard[-1]]
            heading = motion.headings(heading, towards + bias, true_a, end - begin)
    headings.append(heading)
    turned = np.diff(headings, axis=0) + noise * rng.standard_normal((count, robots))
    travelled = speed * spans[:, None] * np.sinc(turned / (2 * np.pi))
    travelled *= 1 + 0.01 * rng.standard_normal((count, robots))
    usable = rng.random((count, robots)) >= unseen
    intervals = Intervals(
        ends[:-1].copy(), ends[1:].copy(), np.array(headings[:-1]), turned, travelled, usable
    )
    prior = Prior(a, speed, float(rng.choice([0.0, 0.1])), 0.2, 0.15, 0.1, 0.05)
    return intervals, Directions(when, u), prior


def assert_same(one, other, rel=1e-7):
    for field in fields(one):
        expected, found = getattr(one, field.name), getattr(other, field.name)
        scale = SCALES.get(field.name, 0.01)
        assert found == pytest.approx(expected, rel=rel, abs=rel * scale), field.name


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    robots=st.sampled_from([1, 2, 3, 14]),
    count=st.integers(1, 100),
    tau=st.sampled_from([0.0, 0.05, 0.14, 0.4]),
    noise=st.sampled_from([0.0, 0.03, 0.3]),
    lost=st.sampled_from([0.0, 0.2]),
    unseen=st.sampled_from([0.0, 0.3]),
    motion=st.sampled_from(["euler", "arc", "exact", "plain"]),
    iterations=st.integers(1, 3),
)
def test_the_compiled_twin_finds_the_same(
    seed, robots, count, tau, noise, lost, unseen, motion, iterations
):
    motion = PLAIN if motion == "plain" else MOTIONS.load(motion)
    intervals, directions, prior = drive(motion, seed, robots, count, tau, noise, lost, unseen)
    constant = constants(motion, prior)
    guess = prior.estimate()
    for _ in range(4):  # a grid first, then steps from an ever better guess
        slow = readable.fit(intervals, directions, prior, guess, motion.headings, iterations)
        fast = compiled.fit(intervals, directions, prior, guess, constant, iterations)
        assert_same(slow, fast)
        guess = fast


@pytest.mark.parametrize("dead_time", [0.0, 0.4])
@pytest.mark.parametrize("std", [0.001, 0.1])
def test_a_dead_time_at_its_bounds(dead_time, std):
    motion = MOTIONS.load("exact")
    intervals, directions, prior = drive(motion, 5, 3, 30, dead_time)
    prior = prior._replace(dead_time=0.0)
    guess = replace(prior.estimate(), dead_time=dead_time, dead_time_std=std)
    slow = readable.fit(intervals, directions, prior, guess, motion.headings)
    fast = compiled.fit(intervals, directions, prior, guess, constants(motion, prior))
    assert_same(slow, fast)
    assert fast.dead_time == pytest.approx(dead_time, abs=0.03)


def test_what_nothing_is_known_of_keeps_the_prior():
    """A robot that was never tracked, and intervals of which none is usable."""
    motion = MOTIONS.load("exact")
    intervals, directions, prior = drive(motion, 3, 3, 20, 0.1)
    constant, guess = constants(motion, prior), prior.estimate()
    for lost in ([1], [0, 1, 2]):
        intervals.usable[:, lost] = False
        slow = readable.fit(intervals, directions, prior, guess, motion.headings)
        fast = compiled.fit(intervals, directions, prior, guess, constant)
        assert_same(slow, fast)
        assert fast.a[lost] == pytest.approx(prior.a[lost])
        assert fast.a_std[lost] == pytest.approx(guess.a_std[lost])
        assert fast.speed_std[lost] == pytest.approx(guess.speed_std[lost])


def test_no_interval_and_no_direction_are_no_news():
    motion = MOTIONS.load("exact")
    intervals, directions, prior = drive(motion, 3, 2, 2, 0.1)
    guess, constant = prior.estimate(), constants(motion, prior)
    nobody = Directions(np.empty(0), np.empty(0))
    assert compiled.fit(intervals.part(slice(-2, None)), nobody, prior, guess, constant) is guess
    nothing = Intervals(*(column[:0] for column in intervals))
    assert compiled.fit(nothing, directions, prior, guess, constant) is guess


def test_intervals_out_of_order_are_fitted_as_well():
    motion = MOTIONS.load("exact")
    intervals, directions, prior = drive(motion, 8, 3, 25, 0.1)
    order = np.random.default_rng(0).permutation(25)
    mixed = Intervals(*(column[order] for column in intervals))
    one, other = (
        compiled.fit(some, directions, prior, prior.estimate(), constants(motion, prior))
        for some in (intervals, mixed)
    )
    assert_same(one, other)


@settings(max_examples=60, deadline=None)
@given(values=st.lists(st.floats(0, 10) | st.sampled_from([1.0, 2.0]), min_size=1, max_size=40))
def test_the_median(values):
    assert compiled._median(np.array(values), len(values)) == np.median(values)


def test_the_constants_are_those_of_the_readable_fit():
    names = [name for name in vars(readable) if name.isupper()]
    assert "CAUCHY" in names
    known = vars(compiled) | vars(turns)
    assert {name: known[name] for name in names} == {
        name: pytest.approx(getattr(readable, name)) for name in names
    }
    assert math.exp(compiled.LN_FACTOR_MAX) == pytest.approx(compiled.FACTOR_MAX)
