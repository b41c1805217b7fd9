"""Tests of the camera `cells` with synthetic films in virtual time: frames, robots, health."""

import itertools
import math
import threading

import numpy as np
import pytest
from testkit.microscope.dish_films import film
from testkit.microscope.needs_opencv import stack
from tetractl_microscope.cell_checks import cell_checks
from tetractl_microscope.pictures.feed import Picture

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Stop, Transmission
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.setup import Bounds
from tetractl.lab.guard import Guard
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.inner_loop import InnerLoop
from tetractl.spec.lab_section import LabLimits
from tetractl.spec.load import parse_spec

pytestmark = pytest.mark.slow

LOADED_S = 1e6  # no load makes a film take so long; nothing waits for it to pass [s]

SPEC = """
name: dish
units: {{length: um}}
arena: {{left: 0, bottom: 0, width: 1200, height: 1200}}
robots:
  - {{name: first, start: [{0}, {1}], target: [600, 600], a: 4, speed: 300}}
  - {{name: second, start: [{2}, {3}], target: [500, 600], a: 3, speed: 300}}
lab:
  camera:
    {{type: cells, source: {{type: file, path: '{4}', rate: 30}}, um_px: 2.3,
     learning: 0.5, connect: {6}{5}}}
  actuator:
    type: field
    port: nowhere
    strength_mt: 2.0
    coils: {{x: {{gain_mt_a: 2, offset_mt: 0}}, y: {{gain_mt_a: 2, offset_mt: 0}}, rotation: 0}}
    current_max_a: 2.0
    slew_max_a_s: 100
"""


def dish(folder, change=lambda picture: picture):
    """A film of two cells and a file of it."""
    synthetic = film(seed=52, side=512, cells=2, crossings=False, seconds=3.0)
    path = stack(folder / "dish.tif", map(change, synthetic.pictures()))
    return synthetic, path


def camera(path, starts, extra="", clock=None):
    text = SPEC.format(*np.round(starts, 1).ravel(), path, extra, LOADED_S)
    experiment = parse_spec(text, "dish").experiment
    camera = experiment.lab.camera.build(experiment.setup, clock or VirtualClock(), lambda: None)
    return experiment, camera


@pytest.mark.long
def test_the_robots_are_the_cells_nearest_to_their_starts_and_stay_them(tmp_path):
    synthetic, path = dish(tmp_path)
    starts = synthetic.body[25, [1, 0], :2]  # the other way round
    _, cells = camera(path, starts)
    with cells:
        assert cells._wait(lambda: bool(cells._searches.end_reason), LOADED_S)
        frames = cells.frames()
        health = cells.check()
    checked = 0
    for frame in frames:
        truth = synthetic.body[frame.number - 1]
        for pose, cell in zip(frame.poses, (1, 0), strict=True):
            # of a cell whose middle has left the picture, the part that is seen has another one
            if pose is not None and 0 < truth[cell, 1] < 512 * 2.3:
                assert math.dist((pose.x, pose.y), truth[cell, :2]) < 15
                checked += 1
    assert checked > 60
    assert health.emulated  # a film shows no cells of this moment
    assert any("has ended" in line for line in health.problems)
    assert health.facts["scale"] == "2.3 um/px"


@pytest.mark.long
def test_a_knock_moves_no_cell_in_the_dish(tmp_path):
    """From picture 50 on all that is seen is shifted, and a rim is new; what is still tells."""
    down = 6
    right = 12
    numbers = itertools.count()

    def knocked(picture):
        return np.roll(picture, (down, right), (0, 1)) if next(numbers) >= 50 else picture

    synthetic, path = dish(tmp_path, knocked)
    _, cells = camera(path, synthetic.body[25, :, :2])
    with cells:
        assert cells._wait(lambda: bool(cells._searches.end_reason), LOADED_S)
        frames = cells.frames()
    off = [
        (
            pose.x - synthetic.body[frame.number - 1, i, 0],
            pose.y - synthetic.body[frame.number - 1, i, 1],
        )
        for frame in frames
        if frame.number > 55
        for i, pose in enumerate(frame.poses)
        if pose is not None
    ]
    assert len(off) > 20
    assert np.abs(np.median(off, axis=0)).max() < 6
    assert cells._view.moved_um == pytest.approx((right * 2.3, -down * 2.3), abs=3)


@pytest.mark.long
def test_a_picture_that_comes_again_is_no_frame(tmp_path):
    """A camera's noise never repeats; black pictures are all alike, and are reported as black."""
    synthetic, path = dish(tmp_path)
    pictures_shown = list(synthetic.pictures())[:40]
    _, cells = camera(path, synthetic.body[25, :, :2])
    for k, grey in enumerate(
        [
            *pictures_shown,
            pictures_shown[-1],
            pictures_shown[-1],
            0 * pictures_shown[0],
            0 * pictures_shown[0],
        ]
    ):
        cells._search(k, Picture(grey, (k + 2) * 33_333_333))
    assert [frame.number for frame in cells.frames()][-4:] == [38, 39, 42, 43]
    assert cells.damaged == 0


def test_the_camera_knows_the_directions_that_were_sent(tmp_path):
    _, cells = camera(tmp_path / "none.tif", np.zeros((2, 2)), ", rotation: 0.5")
    cells.steered(0.5, 1_000_000_000)
    cells.steered(0.5, 1_100_000_000)  # the same again
    cells.steered(None, 2_000_000_000)
    pieces = np.array(cells._field(0.5, 2.5))
    assert pieces == pytest.approx(np.array([(0.5, 0, 0), (1.0, 1, 0), (0.5, 0, 0)]))


class Listener:
    """Stands for a camera that wants to know what is sent, and has one frame of one cell."""

    damaged = 0

    def __init__(self):
        self.heard = []
        self.waiting = [CameraFrame(1, 0, 0, (Pose(500.0, 500.0, 0.0),))]

    def frames(self):
        frames = self.waiting
        self.waiting = []
        return frames

    def steered(self, direction, sent_ns):
        self.heard.append(direction)


class Coils:
    """Stands for an actuator that sends at once."""

    period_ns = SECOND // 10
    failure = None

    def send(self, action, poses, moving, exposed_ns):
        return Transmission(action, 0, (True,), speed=np.zeros(1), turning=np.zeros(1))

    def stop(self, emergency=False):
        return self.send(Stop(), None, (True,), 0)


def test_the_inner_loop_passes_on_what_it_sends():
    """Whatever is sent, stops too, reaches a camera that wants to know."""
    arena = Bounds(0.0, 0.0, 1000.0, 1000.0)
    guard = Guard(GuardRules(("one",), (200.0,), (6.0,), arena, LabLimits()), cell_checks)
    camera = Listener()
    events = threading.Event(), threading.Event()
    loop = InnerLoop(camera, Coils(), guard, VirtualClock(), *events)
    loop.idle_direction = lambda now_ns: 1.0
    loop.step()
    loop.stop()
    assert camera.heard == [1.0, *[None] * 10]
