"""Tests of changing the robots' cells in one thread while another searches an image."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.cells.detect_cells import Light
from tetractl_microscope.cells.kernels.helix_steps import STATE_SIZE
from tetractl_microscope.pictures.feed import Picture

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.spec.load import parse_spec

SPEC = """
name: dish
units: {length: um}
arena: {left: 0, bottom: 0, width: 1200, height: 1200}
robots:
  - {name: first, start: [100, 100], target: [600, 600], a: 4, speed: 300}
  - {name: second, start: [900, 900], target: [500, 600], a: 3, speed: 300}
lab:
  camera: {type: cells, source: {type: file, path: none.avi}, um_px: 2.0}
  actuator:
    type: field
    port: nowhere
    strength_mt: 2.0
    coils: {x: {gain_mt_a: 2, offset_mt: 0}, y: {gain_mt_a: 2, offset_mt: 0}, rotation: 0}
    current_max_a: 2.0
    slew_max_a_s: 100
"""
PLACES_UM = {1: (100.0, 100.0), 2: (900.0, 900.0), 3: (500.0, 200.0)}
"""Where the cells are, by their numbers; 1 and 2 are at the robots' starts."""


def cell(number, x_um, y_um):
    still = np.zeros(STATE_SIZE)
    return SeenCell(number, number, x_um, y_um, 0.0, 0.0, mean=still, sd=still)


class Interrupted(list):
    """Cells in view. `when_counted` and `when_listed` are called, once, at these moments."""

    when_counted = None
    when_listed = None

    def __len__(self):
        self.call("when_counted")
        return super().__len__()

    def __iter__(self):
        self.call("when_listed")
        return super().__iter__()

    def call(self, name):
        meanwhile = getattr(self, name)
        setattr(self, name, None)
        if meanwhile is not None:
            meanwhile()


class Tracker:
    """Stands for a tracker that sees the cells in `PLACES_UM` in each picture.

    `when_born_asked` is called when it is asked which cells are new, which is after the picture's
    cells are known. The new cells have separated from those in `mothers`.
    """

    def __init__(self):
        light = Light(gain=1.0, noise=2.0, contrast=None, changed_fraction=0.0, lost=False)
        self.finder = SimpleNamespace(background=np.zeros((64, 64), np.uint8), light=light)
        self.cells = Interrupted(cell(number, *place) for number, place in PLACES_UM.items())
        self.mothers = ()
        self.when_born_asked = lambda: None

    def track_image(self, picture, seconds, field):
        return self.cells

    @property
    def born(self):
        self.when_born_asked()
        return [SimpleNamespace(mother=mother) for mother in self.mothers]


@pytest.fixture
def camera():
    experiment = parse_spec(SPEC, "dish").experiment
    built = experiment.lab.camera.build(experiment.setup, VirtualClock(), lambda: None)
    built._tracker = Tracker()
    return built


def search(camera, number):
    """Search a picture that differs from the others."""
    grey = np.full((64, 64), number, np.uint8)
    grey[0, 0] = 200
    camera._search(number, Picture(grey, number * SECOND))


def test_cells_that_a_trial_chose_stay_the_robots_of_a_picture_under_search(camera):
    """The picture is the first with enough cells: those at the starts are about to be bound."""
    setup = camera._robots.setup
    camera._tracker.cells.when_counted = lambda: camera.settle(setup, [3, 1])
    search(camera, 1)
    assert camera.robots == (3, 1)


def test_no_frame_has_the_place_of_a_cell_that_was_replaced(camera):
    """Neither the one that waits nor that of the picture under search."""
    search(camera, 1)
    camera._tracker.when_born_asked = lambda: camera.replace(0, 3)
    search(camera, 2)
    camera._tracker.when_born_asked = lambda: None
    assert camera.frames() == []
    search(camera, 3)
    (frame,) = camera.frames()
    assert frame.number == 3
    assert (frame.poses[0].x, frame.poses[0].y) == PLACES_UM[3]


def test_a_candidate_is_where_it_was_in_its_picture(camera):
    """A knock of the next picture is known before the candidates are those of that picture."""
    search(camera, 1)
    tracker = camera._tracker
    tracker.finder.light = replace(tracker.finder.light, shift_px=(50.0, 0.0))
    candidates = []
    tracker.cells.when_listed = lambda: candidates.extend(camera.candidates())
    search(camera, 2)
    places_um = {cell.number: (cell.pose.x, cell.pose.y) for cell in candidates}
    assert places_um == PLACES_UM


def test_a_cell_that_a_trial_chose_has_not_divided_in_place_of_one_before(camera):
    search(camera, 1)
    assert camera.robots == (1, 2)
    setup = camera._robots.setup
    camera._tracker.mothers = (1,)
    camera._tracker.when_born_asked = lambda: camera.settle(setup, [3, 2])
    search(camera, 2)
    assert camera.robots == (3, 2)
    assert camera.divided == ()


def test_a_division_is_noted_though_another_robot_is_replaced_meanwhile(camera):
    search(camera, 1)
    camera._tracker.mothers = (2,)
    camera._tracker.when_born_asked = lambda: camera.replace(0, 3)
    search(camera, 2)
    assert camera.robots == (3, 2)
    assert camera.divided == (1,)
