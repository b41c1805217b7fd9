"""Tests of the filter for swimming cells: headings, turning rates, speeds and their uncertainty."""

import math

import numpy as np
import pytest
from testkit.microscope import helix_steps as oracle
from testkit.microscope.dish_films import film, record
from tetractl_microscope.cells.helix import (
    WALL_REACH_UM,
    HelixFilter,
    new_cell,
    nowhere_near_wall,
)
from tetractl_microscope.cells.kernels.helix_path import smooth
from tetractl_microscope.cells.kernels.helix_steps import (
    DELAY,
    HEADING,
    LEAD,
    SPEED,
    SPEED_MIN,
    STATE_SIZE,
    TURN,
    A,
    C,
    S,
)
from tetractl_microscope.organisms import TETRAHYMENA

from tetractl.core.poses import wrap
from tetractl.core.setup import Bounds
from tetractl.model.swimmers import Swimmers, bodies

pytestmark = pytest.mark.slow

POSITION = 0.5
AXIS = 0.03


def followed(seed, field_known=True, seconds=6.0, cells=8):
    """A filter after a film of which positions and axes are known but for noise."""
    synthetic = film(seed=seed, seconds=seconds, cells=cells)
    random = np.random.default_rng(seed)
    measured = synthetic.body + random.normal(0, 1, synthetic.body.shape) * (
        POSITION,
        POSITION,
        AXIS,
    )
    bank = HelixFilter(field_known)
    field = record(synthetic).pieces
    rows = []
    for i in range(cells):
        vx, vy = np.polyfit(synthetic.times[:6], measured[:6, i, :2], 1)[0]
        heading = math.atan2(vy, vx)
        rows.append(bank.add(*measured[5, i, :2], heading, math.hypot(vx, vy)))
    rows = np.array(rows)
    deviation = np.tile((POSITION, POSITION, AXIS), (cells, 1))
    for k in range(6, len(synthetic.times)):
        step = (synthetic.times[k - 1], synthetic.times[k])
        bank.predict(field(*step) if field_known else [(step[1] - step[0], 0.0, 0.0)])
        bank.update(rows, measured[k], deviation)
    return synthetic, bank, rows


@pytest.mark.long
@pytest.mark.parametrize("field_known", [True, False])
def test_the_heading_is_that_of_the_helix_not_of_the_swaying_body(field_known):
    off = []
    sway = []
    for seed in range(3):
        synthetic, bank, rows = followed(seed, field_known)
        off.append(wrap(bank.means[rows, HEADING] - synthetic.heading[-1]))
        sway.append(wrap(synthetic.body[..., 2] - synthetic.heading).std())
    assert np.mean(sway) > 0.15
    assert np.sqrt(np.mean(np.square(off))) < (0.05 if field_known else 0.12)


@pytest.mark.long
def test_turning_rates_and_speeds_are_within_their_intervals():
    errors = []
    for seed in range(4):
        synthetic, bank, rows = followed(seed)
        deviation = np.sqrt(np.diagonal(bank.covariances[rows], axis1=1, axis2=2))
        for state, truth in ((A, synthetic.cells.a), (SPEED, synthetic.cells.speed)):
            errors.append((bank.means[rows, state] - truth) / deviation[:, state])
            assert np.all(deviation[:, state] < 0.1 * np.abs(truth))
    assert np.mean(np.abs(errors) < 1.96) >= 0.92


def test_a_heading_that_was_the_wrong_way_round_is_turned():
    bank = HelixFilter(field_known=False)
    row = bank.add(0.0, 0.0, math.pi, 300.0)  # it swims the other way
    rows = np.array([row])
    for k in range(1, 60):
        bank.predict([(1 / 30, 0.0, 0.0)])
        if k % 3 == 0:
            bank.widen([row])
        bank.update(rows, np.array([[10.0 * k, 0.0, 0.0]]), np.array([[1.0, 1.0, 0.05]]))
    assert abs(wrap(bank.means[row, HEADING])) < 0.3
    assert bank.means[row, SPEED] > 200


def test_sliding_along_a_wall_teaches_nothing_of_the_response_to_the_field():
    """A cell is kept at a wall for a second by a field that it would follow in open water."""

    def learned(near_wall):
        random = np.random.default_rng(3)
        cells = Swimmers.drawn(random, 12)
        cells.x[:] = -250.0
        cells.y[:] = 300.0 * np.arange(12)
        cells.heading[:] = 0.0
        bank = HelixFilter(near_wall=near_wall)
        rows = np.array([bank.add(x, y, 0.0, 400.0) for x, y in zip(cells.x, cells.y, strict=True)])
        deviation = np.tile((POSITION, POSITION, AXIS), (12, 1))
        for k in range(150):
            angle = (0.8, -0.8, 0.8, 2.5, 3.8)[k // 30]  # to and along the wall, and away from it
            ux = math.cos(angle)
            uy = math.sin(angle)
            for _ in range(8):
                cells.swim((ux, uy), 1 / 240, random, walls=Bounds(-1e6, -1e6, 0.0, 1e6))
            bank.predict([(1 / 30, ux, uy)])
            body = bodies(cells)
            measured = np.column_stack([body.x, body.y, body.axis])
            bank.update(rows, measured + random.normal(0, 1, measured.shape) * deviation, deviation)
        return (bank.means[rows, A] - cells.a) / np.sqrt(bank.covariances[rows, A, A])

    assert np.abs(learned(nowhere_near_wall)).max() > 5
    off = learned(lambda x, y: x > -WALL_REACH_UM)
    assert np.sqrt(np.mean(np.square(off))) < 2.0


@pytest.mark.parametrize(("speed", "walled"), [(300.0, False), (300.0, True), (20.0, False)])
def test_the_compiled_steps_are_those_of_whole_matrices(speed, walled):
    random = np.random.default_rng(5)
    bank = HelixFilter(near_wall=lambda x, y: np.full(len(x), walled))
    row = bank.add(3.0, -2.0, 0.4, speed)
    pieces = [(0.02, 0.6, 0.8), (0.013, -0.8, 0.6)]
    bank.means[row, [C, S, TURN, DELAY, LEAD]] = 4.0, -3.0, 0.1, 0.01, 0.2
    root = random.normal(0, 0.3, (STATE_SIZE, STATE_SIZE))
    bank.covariances[row] += root @ root.T
    m = bank.means[row].copy()
    p = bank.covariances[row].copy()
    *_, model = new_cell(TETRAHYMENA, field_known=True)
    bank.predict(pieces)
    for k, (seconds, *field) in enumerate(pieces):
        if k and not walled:
            change = (0.6, 0.8), (-0.8, 0.6), model[SPEED_MIN]
            f = oracle.slopes(lambda state, change=change: oracle.switched(state, *change), m)
            m = oracle.switched(m, *change)
            p = f @ p @ f.T
        m, p, _ = oracle.move(m, p, model, walled, seconds, field)
    assert bank.means[row] == pytest.approx(m, rel=1e-8)
    assert bank.covariances[row] == pytest.approx(p, rel=1e-5, abs=1e-5)
    for near in (1.0, 60.0):  # and an outlier
        bank.means[row] = m
        bank.covariances[row] = p
        measured = oracle.body(m, model[SPEED_MIN]) + np.array([near, 0.5, 0.1])
        deviation = np.array([1.0, 1.0, 0.05])
        *corrected, likelihood, distance = oracle.correct(m, p, model, measured, deviation)
        ours = bank.update(np.array([row]), measured[None], deviation[None])
        assert np.ravel(ours) == pytest.approx([likelihood, distance], rel=1e-6)
        assert bank.means[row] == pytest.approx(corrected[0], rel=1e-6, abs=1e-6)
        assert bank.covariances[row] == pytest.approx(corrected[1], rel=1e-5, abs=1e-4)


def test_the_smoother_is_that_of_rauch_tung_and_striebel():
    _, bank, rows = followed(2, seconds=1.5, cells=1)
    random = np.random.default_rng(1)
    count = 30
    pieces = [(1 / 30, 0.6, 0.8)] * 15 + [(1 / 30, -0.8, 0.6)] * 14
    m = bank.means[rows[0]].copy()
    p = bank.covariances[rows[0]].copy()
    *_, model = new_cell(TETRAHYMENA, field_known=True)
    truth = m.copy()
    measured = []
    for k in range(count):
        if k:
            seconds, *field = pieces[k - 1]
            truth = oracle.moved(truth, 0 * p, seconds, field, model[SPEED_MIN])
        body = oracle.body(truth, model[SPEED_MIN])
        measured.append(body + random.normal(0, 1, 3) * (POSITION, POSITION, AXIS))
    measured = np.array(measured)
    deviation = np.tile((POSITION, POSITION, AXIS), (count, 1))
    measured[12:16] = np.nan
    wanted = oracle.smooth(m, p, model, measured, deviation, pieces)
    states = np.empty((count, STATE_SIZE))
    first = np.maximum(np.arange(count + 1) - 1, 0)
    bodies = np.empty((count, 3))
    smooth(m.copy(), p, model, measured, deviation, np.array(pieces), first, states, bodies)
    assert bodies[3] == pytest.approx(oracle.body(states[3], model[SPEED_MIN]))
    assert states[:, :SPEED] == pytest.approx(wanted[:, :SPEED], abs=2e-3)
    assert states[:, A] == pytest.approx(wanted[:, A], abs=2e-3)
