"""Tests of a dish of simulated cells between emulated coils, with a driver that a test sets."""

import math

import numpy as np
import pytest
from testkit.emulator.acting import act
from testkit.emulator.device_specs import FIELD_SPEC
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.pictures.dish.live_dish import (
    DROP,
    CellBody,
    CoilField,
    Dish,
    cells_of,
    culture,
)
from tetractl_microscope.coils.section import CoilPair, CoilsSection

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.setup import Bounds
from tetractl.spec.load import parse_spec

COILS = CoilsSection(
    x=CoilPair(gain_mt_a=2.0, offset_mt=0.1), y=CoilPair(gain_mt_a=3.0, offset_mt=-0.2)
)
REFERENCE_MT = 4.0
SETUP = parse_spec(FIELD_SPEC, "lab.yaml").experiment.setup
WALLS = Bounds(left=1000.0, bottom=-2000.0, right=5000.0, top=6000.0)


def field(rotation=0.0):
    acting = ActingFaults()
    coils = COILS.model_copy(update={"rotation": rotation})
    return CoilField(coils, REFERENCE_MT, acting), acting


class Driver:
    """Stands for a current driver whose currents a test sets; it keeps to when it was advanced.

    At first, its currents cancel the ambient field.
    """

    def __init__(self):
        self.currents = (-0.1 / 2.0, 0.2 / 3.0)
        self.running = False
        self.advanced_ns = []

    def advance(self, until_ns):
        self.advanced_ns.append(until_ns)


def dish(walls=None, seed=3, start_ns=0, count=3):
    """A dish of cells that all swim at 500 um/s along x, without chance."""
    cells, _ = culture(count, 0, 0.0, seed)
    cells.speed[:] = 500.0
    cells.helix_um[:] = 0.0
    cells.heading[:] = 0.0
    cells.bias[:] = 0.0
    return Dish(Driver(), field()[0], cells, start_ns, seed, walls)


def test_currents_make_the_field_of_the_coils_relative_to_the_reference():
    made, _ = field()
    assert made.field_mt((0.5, 1.0)) == pytest.approx((1.1, 2.8))
    assert made.relative((0.5, 1.0)) == pytest.approx((1.1 / 4, 2.8 / 4))
    turned, _ = field(rotation=math.pi / 2)
    assert turned.field_mt((0.5, 1.0)) == pytest.approx((-2.8, 1.1))


@pytest.mark.parametrize(
    ("axis", "share", "expected"),
    [("x", 0.5, (0.6, 2.8)), ("y", 0.5, (1.1, 1.3)), ("x", -1.0, (-0.9, 2.8))],
)
def test_a_weak_coil_makes_a_part_of_its_field_and_the_ambient_field_stays(axis, share, expected):
    made, acting = field()
    fault = act(acting, "weak_coils", axis=axis, share=share)
    assert made.field_mt((0.5, 1.0)) == pytest.approx(expected)
    acting.remove(fault)
    assert made.field_mt((0.5, 1.0)) == pytest.approx((1.1, 2.8))
    assert COILS.x.gain_mt_a == 2.0


def test_turned_coils_turn_the_field_by_all_their_angles():
    made, acting = field(rotation=0.3)
    act(acting, "turned_coils", by=0.2)
    act(acting, "turned_coils", by=-0.6)
    x, y = made.field_mt((0.5, 1.0))
    straight, _ = field()
    x0, y0 = straight.field_mt((0.5, 1.0))
    assert math.hypot(x, y) == pytest.approx(math.hypot(x0, y0))
    assert math.atan2(y, x) - math.atan2(y0, x0) == pytest.approx(-0.1)


def test_cells_swim_their_speed_and_the_driver_advances_each_millisecond():
    made = dish(start_ns=SECOND)
    made.advance(SECOND + 500 * MILLISECOND)
    assert made.cells.x == pytest.approx(np.full(3, 250.0))
    assert made.cells.y == pytest.approx(np.zeros(3), abs=1e-9)
    times_ms = np.array(made.driver.advanced_ns) / MILLISECOND
    assert times_ms.tolist() == [*range(1001, 1501)]


def test_time_that_is_less_than_a_step_is_made_up_later():
    made = dish()
    made.advance(MILLISECOND - 1)
    assert made.driver.advanced_ns == []
    made.advance(2 * MILLISECOND - 1)
    assert made.cells.x[0] == 0.0
    for until_ns in range(2 * MILLISECOND, 11 * MILLISECOND, 700_000):
        made.advance(until_ns)
    made.advance(10 * MILLISECOND)
    assert made.driver.advanced_ns == [k * MILLISECOND for k in range(1, 11)]
    assert made.cells.x == pytest.approx(np.full(3, 5.0))


def test_cells_turn_towards_the_field_at_their_rate():
    made = dish()
    made.driver.running = True
    # equation (3): the heading turns by a * |B| * sin(direction of B - heading)
    made.driver.currents = (-0.1 / 2.0, (REFERENCE_MT + 0.2) / 3.0)  # along y, at the reference
    made.advance(4 * MILLISECOND)
    assert made.cells.heading == pytest.approx(made.cells.a * 0.004, rel=0.01)
    assert made.field_mt == pytest.approx((0.0, REFERENCE_MT))


def test_a_placed_cell_stays_until_the_driver_first_makes_a_field():
    made = dish()
    first, second = CellBody("first", made, 0), CellBody("second", made, 1)
    first.place(0.3, 0.4, 0.5)
    made.advance(100 * MILLISECOND)
    assert (first.x, first.y, first.heading) == pytest.approx((0.3, 0.4, 0.5))
    assert second.x == pytest.approx(0.05)
    assert first.standing
    made.driver.running = True
    made.advance(300 * MILLISECOND)
    assert not first.standing
    assert first.x > 0.3 + 0.05
    made.driver.running = False
    made.advance(400 * MILLISECOND)
    assert first.standing
    assert second.x > 0.15  # it swims on


def test_a_fault_that_rests_a_cell_during_a_run_is_not_undone_by_the_next_step():
    made = dish()
    made.driver.running = True
    made.advance(10 * MILLISECOND)
    made.cells.resting[1] = True
    before_um = made.cells.x.copy()
    made.advance(110 * MILLISECOND)
    moved_um = made.cells.x - before_um
    assert moved_um[1] == 0.0
    assert (moved_um[[0, 2]] > 30.0).all()


def test_a_cell_placed_in_a_dish_that_is_not_held_swims_at_once():
    made = dish()
    made.held = False
    body = CellBody("first", made, 0)
    body.place(0.3, 0.4, 0.0)
    made.advance(100 * MILLISECOND)
    assert body.x == pytest.approx(0.35)


def test_a_drop_lies_around_the_middle_of_the_dish_and_faces_everywhere():
    made = dish(walls=WALLS, count=400)
    for positions, low, size in ((made.cells.x, 1000.0, 4000.0), (made.cells.y, -2000.0, 8000.0)):
        places = (positions - low) / size
        assert places.min() == pytest.approx(0.5 - DROP, abs=0.02)
        assert places.max() == pytest.approx(0.5 + DROP, abs=0.02)
        assert places.mean() == pytest.approx(0.5, abs=0.04)
    assert made.cells.heading.min() == pytest.approx(-math.pi, abs=0.1)
    assert made.cells.heading.max() == pytest.approx(math.pi, abs=0.1)
    without = dish(count=4)
    assert without.cells.x.tolist() == without.cells.heading.tolist() == [0.0] * 4


def test_a_drop_depends_on_the_seed_only():
    first, again, other = dish(WALLS, 5), dish(WALLS, 5), dish(WALLS, 6)
    assert (first.cells.x == again.cells.x).all()
    assert (first.cells.x != other.cells.x).all()


def test_cells_do_not_leave_a_dish_with_edges():
    made = dish(walls=WALLS)
    made.cells.x[:] = 4990.0
    made.cells.heading[:] = 0.0
    made.advance(SECOND)
    assert (made.cells.x <= 5000.0).all()


def test_a_cell_that_divides_leaves_a_daughter_as_the_last_cell():
    made = dish()
    made.cells.x[:] = [10.0, 20.0, 30.0]
    names = [CellBody(str(row), made, row) for row in range(3)]
    made.divide(1)
    assert len(made.cells) == 4
    assert made.cells.x[3] == pytest.approx(20.0, abs=60.0)
    assert [body.x for body in names][::2] == [0.01, 0.03]


def test_the_cells_of_a_spec_have_its_rates_and_speeds():
    cells = cells_of(SETUP, 0.05, 7)
    assert cells.a.tolist() == SETUP.a.tolist()
    assert cells.speed == pytest.approx(SETUP.speed * SETUP.metres * 1e6)
    assert cells.bias.tolist() == [0.0] * len(SETUP.names)
    assert cells.walk.tolist() == [0.05] * len(SETUP.names)
    assert (cells_of(SETUP, 0.05, 7).length == cells.length).all()
    assert (cells_of(SETUP, 0.05, 8).length != cells.length).all()
    cells.a[:] = 99.0
    assert 99.0 not in SETUP.a


def test_a_culture_has_cells_with_magnets_first_and_strangers_without():
    cells, names = culture(2, 3, 0.04, 9)
    assert names == ["cell 1", "cell 2", "stranger 3", "stranger 4", "stranger 5"]
    assert len(cells) == 5
    assert ((cells.a > 0) == [True, True, False, False, False]).all()
    assert (cells.walk == 0.04).all()
    assert culture(2, 0, 0.04, 9)[1] == ["cell 1", "cell 2"]
    assert (culture(2, 3, 0.04, 9)[0].length == cells.length).all()
