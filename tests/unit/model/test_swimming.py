"""Tests of steps of swimming cells, against an integration by SciPy and by symmetry."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tetractl.core.clock import SECOND
from tetractl.model.motion.swimming import CellArrays, step, steps_in, steps_until, swim, torque

OPEN = {
    "wall_left": -math.inf,
    "wall_right": math.inf,
    "wall_bottom": -math.inf,
    "wall_top": math.inf,
}
RESTING = dict.fromkeys(CellArrays._fields, 0.0) | OPEN | {"going": 1.0}
angles = st.floats(-math.pi, math.pi)
fields = st.floats(-2, 2)


def cell(**numbers):
    """One cell as arrays of shape (1,); what is not given is 0, and there are no walls."""
    values = RESTING | numbers
    return CellArrays(*(np.array([values[name]], dtype=float) for name in CellArrays._fields))


def moved(seconds, noise=None, **numbers):
    """The cell after a time, by default without noise."""
    swimming = cell(**numbers)
    step(swimming, seconds, np.zeros((steps_in(seconds), 2, 1)) if noise is None else noise)
    return {name: float(getattr(swimming, name)[0]) for name in CellArrays._fields}


@given(angles, angles, st.floats(0.1, 6), st.floats(0, 500), fields, fields)
def test_a_cell_swims_by_the_equations_1_to_3(heading, bias, a, speed, field_x, field_y):
    def slopes(_, state):
        theta = state[2]
        turning = a * (field_y * math.cos(theta + bias) - field_x * math.sin(theta + bias))
        return speed * math.cos(theta) + 7, speed * math.sin(theta) - 5, turning

    expected = solve_ivp(slopes, (0, 0.5), (10, 20, heading), rtol=1e-9, atol=1e-9).y[:, -1]
    motion = {"heading": heading, "bias": bias, "a": a, "speed": speed}
    field = {"field_x": field_x, "field_y": field_y, "flow_x": 7.0, "flow_y": -5.0}
    after = moved(0.5, x=10.0, y=20.0, **motion, **field)
    assert (after["x"], after["y"]) == pytest.approx(expected[:2], abs=0.02)
    assert after["heading"] == pytest.approx(expected[2], abs=1e-3)


@given(angles, fields, fields)
def test_the_derivative_of_the_torque_is_that_of_its_differences(dipole, across, up):
    turning, slope = torque(dipole, across, up)
    assert turning == pytest.approx(up * math.cos(dipole) - across * math.sin(dipole), abs=1e-12)
    ahead, behind = (torque(dipole + h, across, up)[0] for h in (1e-6, -1e-6))
    assert slope == pytest.approx((ahead - behind) / 2e-6, abs=1e-6)


def test_a_resting_cell_only_drifts():
    numbers = {"going": 0.0, "a": 5.0, "speed": 300.0, "phase_rate": 9.0, "walk": 1.0}
    after = moved(0.1, np.ones((steps_in(0.1), 2, 1)), field_y=1.0, flow_x=10.0, **numbers)
    assert after["x"] == pytest.approx(1.0)
    assert (after["y"], after["heading"], after["phase"]) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("wall", "at", "heading", "slides_along", "stays"),
    [
        ("wall_right", 5.0, 0.3, math.pi / 2, "x"),
        ("wall_right", 5.0, -0.3, -math.pi / 2, "x"),
        ("wall_left", -5.0, math.pi - 0.3, math.pi / 2, "x"),
        ("wall_left", -5.0, math.pi + 0.3, -math.pi / 2, "x"),
        ("wall_top", 5.0, math.pi / 2 - 0.3, 0.0, "y"),
        ("wall_top", 5.0, math.pi / 2 + 0.3, math.pi, "y"),
        ("wall_bottom", -5.0, -math.pi / 2 + 0.3, 0.0, "y"),
        ("wall_bottom", -5.0, -math.pi / 2 - 0.3, math.pi, "y"),
    ],
)
def test_a_cell_that_meets_a_wall_slides_along_it(wall, at, heading, slides_along, stays):
    after = moved(0.1, heading=heading, speed=200.0, **{wall: at})
    assert after[stays] == pytest.approx(at)
    assert math.cos(after["heading"] - slides_along) == pytest.approx(1.0)
    other = "y" if stays == "x" else "x"
    assert abs(after[other]) > 5  # it goes on along the wall


def test_a_cell_at_a_wall_that_heads_away_leaves_it():
    after = moved(0.1, x=5.0, heading=math.pi - 0.2, speed=200.0, wall_right=5.0)
    assert after["heading"] == pytest.approx(math.pi - 0.2)
    assert after["x"] < 5.0


def test_noise_makes_the_walk_and_the_depth_that_are_stated():
    rng = np.random.default_rng(7)
    count = 200
    cells = CellArrays(*(np.full(count, RESTING[name]) for name in CellArrays._fields))
    cells.walk[:] = 0.3
    parts = steps_in(0.5)
    step(cells, 0.5, rng.normal(size=(parts, 2, count)))
    assert cells.heading.std() == pytest.approx(0.3 * math.sqrt(0.5), rel=0.2)
    # an Ornstein-Uhlenbeck process from 0: 10 um sqrt(1 - exp(-2 t / 5 s)) with t = 0.5 s
    assert cells.depth.std() == pytest.approx(10 * math.sqrt(1 - math.exp(-0.2)), rel=0.2)


@given(st.lists(st.integers(1, 400), min_size=1, max_size=4))
def test_a_path_does_not_depend_on_how_it_is_divided(parts_ms):
    times = np.cumsum(parts_ms) * 1_000_000 + 3 * SECOND
    numbers = {"speed": 250.0, "a": 4.0, "heading": 0.3, "field_y": 1.0, "walk": 0.2}
    helix = {"helix_um": 15.0, "phase_rate": 6.0, "phase": 0.4}
    noise = np.random.default_rng(1).normal(size=(steps_until(3 * SECOND, times.tolist()), 2, 1))
    whole = cell(**numbers, **helix)
    path = np.zeros((len(times), 3, 1))
    swim(whole, 3 * SECOND, times, noise, 1000.0, path)
    divided = cell(**numbers, **helix)
    since, used = 3 * SECOND, 0
    for k, time_ns in enumerate(times):
        part = np.zeros((1, 3, 1))
        swim(divided, since, times[k : k + 1], noise[used:], 1000.0, part)
        used += steps_in((time_ns - since) / SECOND)
        since = time_ns
        assert part[0] == pytest.approx(path[k])
    aside = 15.0 * math.cos(float(whole.phase[0]))
    heading = float(whole.heading[0])
    x, y = float(whole.x[0]), float(whole.y[0])
    body = (x - aside * math.sin(heading)) / 1000, (y + aside * math.cos(heading)) / 1000
    assert tuple(path[-1, :2, 0]) == pytest.approx(body)
