"""An emulated lab in virtual time, and the rig of our side that is connected to it."""

import threading

from tetractl.core.setup import Setup
from tetractl.emulate.emulated_lab import EmulatedLab
from tetractl.emulate.script import NOTHING, Script
from tetractl.emulate.sides import Options
from tetractl.emulate.virtual_wires import LabClock, VirtualLoop, memory_wires
from tetractl.experiment.lab_section import LabSection
from tetractl.lab.rig import Rig


def started(
    lab: LabSection, setup: Setup, clock: LabClock, options: Options, script: Script = NOTHING
) -> EmulatedLab:
    """Return an emulated lab that runs on a clock; nothing in it has to be released."""
    loop, wires = VirtualLoop, memory_wires(clock)
    emulation = EmulatedLab(lab, setup, script, options, make_loop=loop, wires=wires).__enter__()
    assert isinstance(emulation.loop, VirtualLoop)
    clock.timeline = emulation.timeline
    clock.steps.insert(0, emulation.loop.poll)
    return emulation


def connected(
    emulation: EmulatedLab,
    lab: LabSection,
    setup: Setup,
    clock: LabClock,
    emergency: threading.Event | None = None,
) -> Rig:
    """Return the rig between the devices of an emulated lab in virtual time."""
    wake = threading.Event()
    camera = emulation.camera.connected(setup, clock, wake.set)
    actuator = emulation.actuator.connected(setup, clock)
    rig = Rig(camera, actuator, lab.limits, setup, clock, emergency, wake, threaded=False)
    clock.steps.append(rig.loop.turn)
    return rig
