"""Tests of a real and an emulated actuator whose radio fails as a script demands."""

import threading

from testkit.labs import FakeActuator, fake_lab
from testkit.trials import experiment
from tetractl_emulator.half_real import TwinActuator

from tetractl.lab.inner_loop import InnerLoop
from tetractl.spec.lab_section import STOPS


def test_an_emulated_radio_that_fails_keeps_no_stop_from_the_real_robots():
    """Regression: the loop took its error for one of the real radio, and left out the nine stops
    that were still to be sent."""
    lab = fake_lab(experiment().setup)
    lab.plant.open()
    lab.clock.steps.remove(lab.plant.rig.loop.step)  # the loop below is the only one
    emulated = FakeActuator(lab.world, failure="the port of the emulated radio is gone")
    both = TwinActuator(lab.actuator, emulated)
    guard = lab.plant.rig.loop.guard
    loop = InnerLoop(lab.camera, both, guard, lab.clock, threading.Event(), threading.Event())
    first = loop.stop()
    stops = lab.actuator.sent
    assert len(stops) == STOPS
    assert first is stops[0]
