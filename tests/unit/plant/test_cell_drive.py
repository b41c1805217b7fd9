"""Tests of simulated robots that are cells of the swimming model."""

import math

import numpy as np
import pytest

from tetractl.core.commands import FieldOff, Steer, Stop
from tetractl.core.poses import Poses
from tetractl.core.setup import Bounds
from tetractl.model.motion import swimming
from tetractl.model.swimmers import Swimmers
from tetractl.plant import drive_kernels as kernel
from tetractl.plant.cell_drive import CellDrive
from tetractl.plant.sim_section import CultureSection
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.disturbance import DelayedCommand
from tetractl.spec.load import parse_spec

pytestmark = pytest.mark.slow

SPEC = """
name: cells
units: {length: mm}
arena: {left: 0, bottom: 0, width: 2, height: 2}
robots:
  - {name: one, start: [0.5, 0.5], target: [1.5, 0.7], a: 5, speed: 0.3}
  - {name: two, start: [0.5, 1.5], target: [1.5, 1.4], a: 3, speed: 0.33}
"""


def setup():
    return parse_spec(SPEC, "cells.yaml").experiment.setup


def drive(walk=0.0, seed=1, **section):
    """Cells that neither swim in a flow nor have dipoles that are off, unless the section says."""
    quiet = {"dipole": 0.0, "drift": 0.0} | section
    culture = CultureSection.model_validate(quiet)
    cells = setup()
    random = np.random.SeedSequence(seed)
    return CellDrive(culture, cells, cells.a, cells.speed, cells.starts, walk, random)


def swum(cells, seconds, since=0.0):
    """Positions and headings, (M, N) each, of cells at times [s]."""
    times = np.rint(np.atleast_1d(seconds) * 1e9).astype(np.int64)
    path = cells.advance(round(since * 1e9), times, np.ones(times.size, np.bool_))
    return path.transpose(1, 0, 2)


def sent(action, reached=(True, True)):
    """A command as it acts on the cells that it reaches."""
    return DelayedCommand(0, 0, action, np.array(reached))


def test_their_axes_turn_by_3_and_their_bodies_stay_a_helix_off():
    cells = drive()
    cells.apply(sent(Steer(math.pi / 2)))
    x, y, heading = swum(cells, np.linspace(0.01, 0.4, 40))
    for i, a in enumerate((5.0, 3.0)):
        angle_left = 2 * math.atan(math.exp(-a * 0.4))
        assert math.pi / 2 - heading[-1, i] == pytest.approx(angle_left, abs=2e-3)
    axis_x = cells.cells.x / 1000
    axis_y = cells.cells.y / 1000
    radius = cells.cells.helix_um / 1000
    assert (np.hypot(x[-1] - axis_x, y[-1] - axis_y) <= radius + 1e-12).all()
    assert np.ptp(radius) > 0


def test_compiled_they_swim_as_the_readable_ones_do():
    """The same bits, along walls too and with a cell that rests."""
    random = np.random.default_rng(4)
    cells = Swimmers.drawn(random, 12)
    cells.x, cells.y = random.uniform(0, 1000, (2, 12))
    cells.resting[3] = True
    plain = cells.to_cell_arrays((0.6, -0.8), (3.0, -2.0), Bounds(0.0, 0.0, 1000.0, 1000.0))
    compiled = swimming.CellArrays(*(values.copy() for values in plain))
    times = np.array([1_000_000, 13_700_000, 3_000_000_000])
    noise = random.standard_normal((swimming.steps_until(0, times.tolist()), 2, 12))
    plain_path, path = np.zeros((2, 3, 3, 12))
    swimming.swim(plain, 0, times, noise, 1000.0, plain_path)
    kernel.swim(compiled, 0, times, noise, 1000.0, path)
    assert np.array_equal(compiled, plain)
    assert np.array_equal(path, plain_path)
    assert path[-1].any()
    assert (np.array([compiled.x, compiled.y]) % 1000 == 0).any()
    assert (path[1, :2, 3] != path[0, :2, 3]).all()


def test_a_command_acts_on_those_that_it_reaches_and_a_stop_holds():
    cells = drive()
    cells.apply(sent(Steer(math.pi), reached=(True, False)))
    assert cells.moving.tolist() == [1, 0]
    cells.apply(sent(FieldOff()))
    before = cells.poses.heading.copy()
    swum(cells, 0.3)
    assert cells.moving.tolist() == [1, 1]
    assert np.allclose(cells.poses.heading, before)  # no field turns them
    cells.apply(sent(Stop()))
    places = cells.poses.array()
    swum(cells, 0.3)
    assert np.allclose(cells.poses.array(), places)


def test_a_pose_that_is_set_is_the_bodys():
    cells = drive()
    wanted = Poses.from_array(np.array([[1.0, 0.4, 0.3], [0.2, 1.9, -2.0]]))
    cells.poses = wanted
    assert np.allclose(cells.poses.array(), wanted.array())


def test_no_cell_leaves_its_dish(tmp_path):
    """Straight at the wall for 8 s: they slide along it, and stay."""
    text = SPEC + (
        "controller: {type: sequence, directions: [" + "0.3, " * 39 + "0.3]}\n"
        "plant: {type: sim, cells: {}, heading_noise: 0.05, truth_rate: 240,"
        " camera_rate: 30}\n"
    )
    spec = parse_spec(text, "cells.yaml")
    result = run_logged(spec, tmp_path, 0, (), Interrupt())
    assert log_path(tmp_path, 0).exists()
    assert not result.left_arena
    assert 0 <= min(result.verdict.edge) < 0.02
