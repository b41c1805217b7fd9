"""Tests of the emulated mat: what cubes read and when they report it, in virtual time."""

import pytest
from testkit.cli import tetractl
from testkit.emulator.acting import act
from testkit.emulator.virtual_lab import virtual_lab
from tetractl_toio.camera import compute_reading
from tetractl_toio.emulated.mat import PRINT_BOTTOM, PRINT_LEFT, PRINT_RIGHT, PRINT_TOP
from tetractl_toio.messages import Characteristic, Unpacker, decode_reading

from tetractl.core.clock import MILLISECOND

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    place = tmp_path_factory.mktemp("cubes")
    tetractl(place, "init", "cubes", "--lab", "--robots", "toio").ok()
    return place / "cubes.yaml"


class Mat:
    """The emulated mat below three cubes whose connections lose nothing, and what they report."""

    def __init__(self, lab):
        self.lab = lab
        self.mat = lab.emulation.camera
        self.acting = self.mat.acting
        self.cubes = self.mat.cubes
        self.reported = [[] for _ in self.cubes]
        for cube, reported in zip(self.cubes, self.reported, strict=True):
            cube.connection.port.write = self._keep(reported)

    def _keep(self, reported):
        def write(data):
            for characteristic, payload in Unpacker().feed(data):
                if characteristic == Characteristic.ID:
                    reported.append(decode_reading(payload))

        return write

    def notify(self, on=True):
        for cube in self.cubes:
            cube.program.is_notifying = on

    def run(self, ms):
        self.lab.clock.sleep_until(self.lab.clock.now() + ms * MILLISECOND)

    def truth(self, i):
        cube = self.cubes[i]
        section = self.mat._section
        return compute_reading((cube.x, cube.y, cube.heading), section.origin, section.unit_mm)

    def place(self, i, x_units, y_units):
        """Put a cube at a place of the mat, in its units."""
        section = self.mat._section
        x, y = section.origin
        self.cubes[i].place((x_units - x) * section.unit_mm, (y - y_units) * section.unit_mm, 0.0)

    def age_ms(self, i):
        return (self.lab.clock.true_ns - self.mat.shown_ns[i]) / MILLISECOND


@pytest.fixture
def mat(spec):
    lossless = "emulation: {actuator: {loss: 0.0, interval: 0.01}}"
    with virtual_lab(None, spec=spec, script=lossless) as lab:
        yield Mat(lab)


def test_a_cube_reports_its_place_every_10_ms_once_it_is_told_to(mat):
    mat.run(100)
    assert mat.reported == [[], [], []]
    mat.notify()
    mat.run(500)
    for i, reported in enumerate(mat.reported):
        assert len(reported) == pytest.approx(50, abs=2)
        assert set(reported) == {mat.truth(i)}
        assert mat.age_ms(i) <= 21
    assert mat.mat.close()["frames"] == pytest.approx(150, abs=6)


def test_a_cube_that_is_asked_reports_once(mat):
    mat.cubes[1].program.is_reading_requested = True
    mat.run(100)
    assert mat.reported == [[], [mat.truth(1)], []]
    assert mat.age_ms(0) > 50


def test_a_cube_off_the_mat_says_so_once_and_when_it_is_asked(mat):
    mat.notify()
    mat.run(50)
    hidden = act(mat.acting, "untracked", robot=mat.cubes[0].name)
    count = len(mat.reported[0])
    mat.run(300)
    assert mat.reported[0][count:] == [None]
    assert mat.age_ms(0) > 280
    assert mat.age_ms(1) <= 21
    mat.cubes[0].program.is_reading_requested = True
    mat.run(100)
    assert mat.reported[0][count:] == [None, None]
    mat.acting.remove(hidden)
    mat.run(100)
    assert mat.reported[0][-1] == mat.truth(0)
    assert mat.age_ms(0) <= 21


@pytest.mark.parametrize(
    ("x", "y", "seen"),
    [
        (PRINT_LEFT, PRINT_TOP, True),
        (PRINT_RIGHT, PRINT_BOTTOM, True),
        (PRINT_LEFT - 1, PRINT_TOP, False),
        (PRINT_RIGHT + 1, PRINT_BOTTOM, False),
        (PRINT_LEFT, PRINT_TOP - 1, False),
        (PRINT_RIGHT, PRINT_BOTTOM + 1, False),
    ],
)
def test_the_mat_is_printed_up_to_its_edges(mat, x, y, seen):
    mat.notify()
    mat.place(2, x, y)
    mat.run(50)
    reading = mat.reported[2][-1] if mat.reported[2] else None
    assert (reading is not None) == seen
    if seen:
        assert (reading.x, reading.y) == (x, y)


def test_a_frozen_cube_repeats_its_last_reading_and_shows_its_place_only_while_it_stands(mat):
    mat.notify()
    mat.run(50)
    frozen = act(mat.acting, "freeze")
    before = mat.truth(0)
    mat.run(100)
    assert mat.age_ms(0) <= 21  # it stands where it was
    mat.place(0, before.x + 30, before.y - 20)
    mat.run(200)
    assert set(mat.reported[0]) == {before}
    assert mat.age_ms(0) > 170
    mat.acting.remove(frozen)
    mat.run(50)
    assert mat.reported[0][-1] == mat.truth(0) != before


def test_no_cube_reports_during_a_fault_of_all_readings(mat):
    mat.notify()
    mat.run(50)
    silent = act(mat.acting, "no_frames")
    mat.run(15)
    counts = [len(reported) for reported in mat.reported]
    mat.run(200)
    assert [len(reported) for reported in mat.reported] == counts
    mat.acting.remove(silent)
    mat.run(50)
    assert all(len(r) > count for r, count in zip(mat.reported, counts, strict=True))


def test_a_wrong_place_is_off_by_all_jumps_of_this_cube(mat):
    mat.notify()
    unit_mm = mat.mat._section.unit_mm
    for by in ([10 * unit_mm, 0.0], [0.0, -5 * unit_mm]):
        act(mat.acting, "jump", robot=mat.cubes[0].name, by=by)
    mat.run(50)
    green, blue = mat.truth(0), mat.truth(1)
    wrong = mat.reported[0][-1]
    assert (wrong.x - green.x, wrong.y - green.y) == (10, 5)
    assert mat.reported[1][-1] == blue


def test_a_reading_that_is_lost_shows_nothing(mat):
    mat.notify()
    mat.run(50)
    act(mat.acting, "loss", share=1.0)
    mat.run(200)
    assert min(mat.age_ms(i) for i in range(3)) > 170
