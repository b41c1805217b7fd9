from base64 import b64decode
from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support import random_trials as made

from tetractl.log.read.reader import read_trial
from tetractl.report.trial_data import MISSING, corners, rounded, trial_data


def off(curves, points):
    """Return how far points (N, 2) are from N curves (n, N, 2) of straight lines."""
    share = np.linspace(0, 1, 501)[:, None, None]
    lines = [first + share * (last - first) for first, last in pairwise(curves)] or [curves]
    return np.linalg.norm(np.concatenate(lines) - points, axis=2).min(axis=0)


@given(
    st.integers(0, 2**32),
    st.lists(st.integers(0, 60), max_size=4),
    st.integers(1, 3),
    st.floats(1e-3, 1),
)
def test_thinned_curves_stay_within_the_error(seed, counts, robots, error):
    rng = np.random.default_rng(seed)
    curves = [np.cumsum(rng.normal(size=(n, robots, 2)), axis=0) for n in counts]
    for points, kept in zip(curves, corners(curves, error), strict=True):
        assert kept[[0, -1]].tolist() == [0, len(points) - 1] if len(points) else not len(kept)
        assert (np.diff(kept) > 0).all()
        for first, last in pairwise(kept):
            for inner in points[first + 1 : last]:
                assert off(points[[first, last]], inner).max() <= error * 1.01


def test_a_straight_line_is_its_ends_and_no_curve_is_nothing():
    line = np.linspace((0, 0), (3, 4), 9)[:, None]
    assert [kept.tolist() for kept in corners([line, line[:0], line], 1e-6)] == [[0, 8], [], [0, 8]]
    assert corners([], 1e-6) == []


def unpack(packed):
    if "f4" in packed:
        return np.frombuffer(b64decode(packed["f4"]), "<f4")
    steps = np.frombuffer(b64decode(packed["i2"]), "<i2")
    return packed["offset"] + packed["scale"] * steps


def test_the_page_has_each_plan_to_a_thousandth_of_the_arena_and_each_search(tmp_path):
    log = read_trial(made.write(made.trial(3, steps=4), tmp_path / "t.mcap"))
    arena, robots = log.start.setup.arena, len(log.start.setup.names)
    turn = np.linspace(0, 2 * np.pi, 40)[:, None, None]
    circles = 0.3 * arena.width * np.concatenate([np.cos(turn), np.sin(turn), turn], axis=2)
    path = np.repeat(circles, robots, axis=1)
    steps = tuple(replace(step, plan=replace(step.plan, path=path)) for step in log.steps)
    log = replace(log, steps=steps)
    data = trial_data(log, "t")
    at, plan = data["plan"]["at"], unpack(data["plan"]["values"]).reshape(-1, robots, 2)
    for k, step in enumerate(log.steps):
        shown = plan[at[k] : at[k + 1]]
        size = 1e-3 * max(arena.width, arena.height) + np.ptp(plan) / 1e4
        for point in step.plan.path[..., :2]:
            assert off(shown, point).max() <= size
        first, last = data["history"]["at"][k : k + 2]
        kept = unpack(data["history"]["iterations"])[first:last].astype(int)
        values = unpack(data["history"]["values"])[first:last]
        assert np.allclose(values, step.plan.search.history[kept], rtol=1e-6)
    assert trial_data(log, "t", plans=False)["plan"] is None


@given(st.lists(st.floats(-1e300, 1e300) | st.sampled_from([np.nan, np.inf]), max_size=20))
def test_rounded_values_are_near_and_what_is_not_finite_is_missing(values):
    packed, wanted = rounded(values), np.array(values)
    steps, finite = np.frombuffer(b64decode(packed["i2"]), "<i2"), np.isfinite(wanted)
    assert ((steps == MISSING) == ~finite).all()
    if finite.any():
        extent = wanted[finite].max() / 2 - wanted[finite].min() / 2
        gaps = np.abs((packed["offset"] + packed["scale"] * steps.astype(float)) - wanted)[finite]
        assert (gaps <= extent / 60_000 + 1e-9 * np.abs(wanted[finite]) + 1).all()
