import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.coils.section import CoilsSection, step_towards

angles = st.floats(-10, 10)
gains = st.floats(0.1, 10) | st.floats(-10, -0.1)
parts = st.floats(-0.9, 0.9)  # of what the coils can cancel


def made(gain, offset, rotation):
    x, y = ({"gain_mt_a": g, "offset_mt": o} for g, o in zip(gain, offset, strict=True))
    return CoilsSection(x=x, y=y, rotation=rotation)


@st.composite
def coils_and_limit(draw):
    gain = draw(gains), draw(gains)
    limit = draw(st.floats(0.1, 5))
    offset = tuple(draw(parts) * abs(g) * limit for g in gain)
    return made(gain, offset, draw(angles)), limit


@given(coils_and_limit(), angles, st.floats(0.01, 20))
def test_the_field_has_the_direction_wished_and_all_the_strength_there_is(
    coils_and_limit, direction, wished
):
    coils, limit = coils_and_limit
    currents = coils.currents(direction, wished, limit)
    x, y = coils.field(currents)
    strength = math.hypot(x, y)
    assert max(map(abs, currents)) <= limit * (1 + 1e-9)
    assert strength == pytest.approx(min(wished, coils.reach(direction, limit)), rel=1e-6)
    assert math.remainder(math.atan2(y, x) - direction, math.tau) == pytest.approx(0, abs=1e-6)
    if strength < wished * (1 - 1e-9):
        assert max(map(abs, currents)) == pytest.approx(limit, rel=1e-6)


@given(coils_and_limit(), angles)
def test_the_least_reach_is_had_in_every_direction(coils_and_limit, direction):
    coils, limit = coils_and_limit
    least = coils.least_reach(limit)
    assert coils.reach(direction, limit) >= least * (1 - 1e-9)
    worst = [coils.reach(coils.rotation + k * math.pi / 2, limit) for k in range(4)]
    assert min(worst) == pytest.approx(least, rel=1e-6)


pairs = st.tuples(st.floats(-5, 5), st.floats(-5, 5))


@given(pairs, pairs, st.floats(0, 10))
def test_approaching_is_a_straight_line_of_limited_steps(now, wished, step):
    got = step_towards(now, wished, step)
    moves = [g - n for g, n in zip(got, now, strict=True)]
    gaps = [w - n for w, n in zip(wished, now, strict=True)]
    peak = max(map(abs, gaps))
    largest_move = max(map(abs, moves))
    assert largest_move == pytest.approx(min(step, peak), abs=1e-9)
    assert moves[0] * gaps[1] == pytest.approx(moves[1] * gaps[0], abs=1e-9)
    assert (got == wished) == (peak <= step) or step == pytest.approx(peak, abs=1e-9)


def test_a_pair_of_coils_by_hand():
    coils = made((2.0, -4.0), (0.1, -0.2), math.pi / 2)
    x, y = coils.currents(math.pi / 2, 1.1, 10.0)  # along the x pair
    assert (x, y) == (pytest.approx(0.5), pytest.approx(-0.05))
    x, y = coils.currents(math.pi, 1.0, 10.0)  # along the y pair
    assert (x, y) == (pytest.approx(-0.05), pytest.approx(-0.3))
    assert coils.field((0.0, 0.0)) == (pytest.approx(0.2), pytest.approx(0.1))
