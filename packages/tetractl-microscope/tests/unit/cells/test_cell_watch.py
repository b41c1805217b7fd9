"""Tests of how the camera of a dish reports lost robots and their replacements."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import pytest
from testkit.labs import fake_lab
from testkit.trials import experiment
from tetractl_microscope.cells.cell_watch import CellWatch, Identities
from tetractl_microscope.choice.candidate import RobotCandidate

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.errors import AbortError
from tetractl.core.guard_findings import Lose
from tetractl.core.poses import Pose
from tetractl.core.trial import Note
from tetractl.spec.lab_section import LabLimits

SETUP = experiment().setup
BLUE = SETUP.names.index("blue")


@dataclass
class Dish:
    """A camera that tracks cells, of which those with the numbers 1, 2, 3 are the robots."""

    robots: list[int] = field(default_factory=lambda: [1, 2, 3])
    divided: set[int] = field(default_factory=set)
    cells: list[RobotCandidate] = field(default_factory=list)

    def candidates(self):
        return self.cells

    def settle(self, setup, numbers):
        self.robots = list(numbers)

    def replace(self, robot, number):
        self.robots[robot] = number


def cell(number, a, free=True):
    speed = float(SETUP.speed[BLUE])
    return RobotCandidate(number, Pose(900.0, 900.0, 0.0), a, 0.01 * a, speed, 0.01 * speed, free)


def test_probabilities_count_only_for_frames_that_the_guard_has_accepted():
    rows = [(0, 1.0), (1, 0.5), (2, 0.5), (3, 0.5)]
    waiting = deque(Identities(t, np.array([1.0, p, 1.0])) for t, p in rows)
    watch = CellWatch(Dish(), waiting, SETUP, 3.0)
    assert list(watch.see(0)) == []
    assert [note.t_ns for note in watch.see(2)] == [2]
    assert [identities.exposed_ns for identities in waiting] == [3]


@pytest.mark.parametrize(
    ("cells", "number"),
    [
        ([cell(7, 1.1 * SETUP.a[BLUE]), cell(8, 1.02 * SETUP.a[BLUE])], 8),  # the more similar
        ([cell(7, 1.02 * SETUP.a[BLUE], free=False), cell(8, 1.1 * SETUP.a[BLUE])], 8),
        ([cell(1, SETUP.a[BLUE]), cell(8, 1.1 * SETUP.a[BLUE])], 8),  # 1 is a robot
        ([cell(8, 2.0 * SETUP.a[BLUE])], 2),  # none is similar: blue's cell stays
    ],
)
def test_the_most_similar_free_cell_replaces_a_lost_one(cells, number):
    dish = Dish(cells=cells)
    text = CellWatch(dish, deque(), SETUP, 3.0).replace(BLUE)
    assert dish.robots == [1, number, 3]
    assert text.startswith("is now another cell: a ") == (number == 8)


def test_the_lab_aborts_where_its_camera_does_not_know_for_long_who_is_who():
    lab = fake_lab(SETUP, LabLimits(identity=1.0))
    sure = [1.0, 1.0, 1.0]
    waiting = deque()
    frames = lab.camera.frames

    def filmed():
        fresh = frames()
        waiting.extend(Identities(frame.sampled_ns, np.array(sure)) for frame in fresh)
        return fresh

    lab.camera.frames = filmed
    lab.camera.watch = lambda setup, limits: CellWatch(Dish(), waiting, setup, limits.identity)
    plant = lab.plant
    notes = []
    plant.open()
    with pytest.raises(AbortError, match="for 1 s it has been uncertain which cell is blue"):
        for k in range(10):
            sure[BLUE] = 1.0 if k < 3 else 0.6
            plant.observe()
            plant.send(Steer(1.5))
            notes += [news.text for news in plant.events() if isinstance(news, Note)]
            lab.clock.sleep_until(lab.clock.now() + SECOND // 5)
    plant.stop()
    plant.close()
    assert [text.split(";")[0] for text in notes] == ["blue has met another cell"]


def test_a_cell_that_has_divided_is_lost():
    watch = CellWatch(Dish(divided={BLUE}), deque(), SETUP, 3.0)
    text = "blue has divided, or has parted from an unknown cell that it had met"
    assert list(watch.lost()) == [Lose(BLUE, text)]
