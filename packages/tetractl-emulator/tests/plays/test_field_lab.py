"""Tests of emulated cells in a field, from the camera to the driver and the coils."""

import numpy as np
import pytest
from testkit.emulator.device_specs import FIELD_SPEC
from testkit.emulator.virtual_lab import virtual_lab
from tetractl_emulator import firmware

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Steer

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found"),
]


def test_cells_are_steered_without_any_wheels_and_swim_on_after_the_stop(tmp_path):
    with virtual_lab(tmp_path, spec=FIELD_SPEC) as lab:
        plant = lab.plant
        clock = lab.clock
        try:
            info = plant.open()
            assert info.facts["field_driver_version"] == "1"
            direction = 0.0
            for _ in range(10):
                plant.observe()
                command = plant.send(Steer(direction))
                assert command.left is None
                assert command.delivered == (True, True)
                clock.sleep_until(clock.now() + SECOND // 10)
            headings = plant.observe().poses.heading
            stop = plant.stop()
            verdict = plant.settle()
        finally:
            plant.stop()
            plant.close()
        turned = [np.angle(np.exp(1j * (direction - heading))) for heading in headings]
        assert np.abs(turned).max() < 0.3
        assert stop.direction is None
        assert verdict.not_at_rest == ""
        others = [item for item in plant.events() if isinstance(item, Command)]
        assert len(others) > 10
        before = [(body.x, body.y) for body in lab.robots]
        clock.sleep_until(clock.now() + SECOND // 5)
        after = [(body.x, body.y) for body in lab.robots]
        assert all(a != b for a, b in zip(before, after, strict=True))
