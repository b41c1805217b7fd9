"""The emulated driver and its cells in virtual time: the whole path from a direction to a cell."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from support.field_bench import LIMITS, Wire, section

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.poses import Pose
from tetractl.core.setup import MM
from tetractl.emulate import firmware
from tetractl.emulate.dish.live_dish import CellBody, Dish, cells_of
from tetractl.emulate.field import CurrentDriver
from tetractl.emulate.loop import Timeline
from tetractl.emulate.port import PseudoPort
from tetractl.lab.actuators.field.actuator import FieldActuator
from tetractl.lab.actuators.field.driver import DriverStatus

pytestmark = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")

A, SPEED = 4.0, 0.3  # rad/s, mm/s


class Stage:
    """One cell in a dish under the actuator, in virtual time; the ambient field is cancelled."""

    def __init__(self, tmp_path, heading=0.0, noise=0.0, seed=1, **changes):
        spec = section(**changes)
        setup = SimpleNamespace(
            names=("cell",), a=np.array([A]), speed=np.array([SPEED]), metres=MM
        )
        self.clock = VirtualClock()
        self.timeline = Timeline(lambda until: self.dish.advance(until))
        self.driver = CurrentDriver(self.timeline, PseudoPort(tmp_path / "unused"), LIMITS)
        coils, reference = spec.calibrated_coils(), spec.strength_mt
        cells = cells_of(setup, noise, seed)
        self.dish = Dish(self.driver, coils, reference, cells, 0, seed)
        self.cell = CellBody("cell", self.dish, 0)
        self.cell.place(1.0, 2.0, heading)
        self.actuator = FieldActuator(spec, setup, self.clock)
        self.actuator.driver = Wire(self.clock, self.driver)

    def run(self, seconds, direction=None):
        """Let time pass, under a held direction or without any command."""
        end = self.clock.now() + round(seconds * SECOND)
        while self.clock.now() < end:
            if direction is not None:
                pose = Pose(self.cell.x, self.cell.y, self.cell.heading)
                self.actuator.steer(direction, [pose], [True], self.clock.now())
            self.clock.sleep_until(min(end, self.clock.now() + self.actuator.period_ns))
            self.timeline.run_to(self.clock.now())


def test_a_cell_turns_as_the_closed_form_says(tmp_path):
    stage = Stage(tmp_path, heading=-0.7)
    stage.run(0.8, direction=1.1)
    phi = 2 * math.atan(math.tan(1.8 / 2) * math.exp(-A * 0.8))
    assert 1.1 - stage.cell.heading == pytest.approx(phi, abs=0.03)  # coils lag, currents slew
    assert stage.dish.field_mt == pytest.approx((2 * math.cos(1.1), 2 * math.sin(1.1)), abs=0.005)


def test_the_watchdog_switches_the_field_off(tmp_path):
    stage = Stage(tmp_path)
    stage.run(0.5, direction=1.0)
    stage.run(0.22)  # the last command came 0.025 s before
    assert stage.driver.status == DriverStatus.RUNNING
    stage.run(0.08)
    assert stage.driver.status == DriverStatus.SILENT
    assert max(map(abs, stage.driver.currents)) < 1e-3
