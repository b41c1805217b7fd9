"""The plant `emulated`: the emulated lab and our side of it, in one process and in virtual time.

Guard, inner loop, camera, actuator, their frames, firmware and pictures are those of a run in the
lab; only wires and clock differ, so the speed of the computer changes nothing. Planning takes no
virtual time, as in a simulation.
"""

import threading
from typing import Literal

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.setup import Setup
from tetractl.emulate.emulated_lab import EmulatedLab
from tetractl.emulate.script import NOTHING, Script, Sides
from tetractl.emulate.sides import Options
from tetractl.emulate.virtual_wires import LabClock, MemoryWires, VirtualLoop
from tetractl.experiment.lab_section import LabSection
from tetractl.lab.rig import Rig
from tetractl.plant.lab_plant import RiggedSection


class EmulatedPlantSection(RiggedSection):
    """A lab that is emulated in virtual time: no device is used."""

    type: Literal["emulated"] = "emulated"

    @property
    def real_time(self) -> bool:
        """False: no device is driven."""
        return False

    def clock(self) -> Clock:
        """Return a clock in virtual time."""
        return LabClock()

    def require_devices(self) -> None:
        """Raise SpecError if a device cannot be emulated, AbortError if software is missing."""
        Sides.of(self.camera.type, self.actuator.type)

    def rig(
        self,
        setup: Setup,
        clock: Clock,
        seed: np.random.SeedSequence,
        emergency: threading.Event | None = None,
        chosen: bool = False,
    ) -> Rig:
        """Return the rig of an emulated lab of its own. All trials with one root seed have the same
        cells in the dish; everything else is drawn from the trial's `seed`.
        """
        assert isinstance(clock, LabClock), "`clock` returned it"
        dish, own = seed.entropy, int(seed.generate_state(2)[1])
        assert isinstance(dish, int), "the root seed of trials is one number"
        options = Options(address=None, seed=own, chosen=chosen, dish=dish)
        emulation = started(self, setup, clock, options)
        return connected(emulation, self, setup, clock, emergency)


def started(
    lab: LabSection, setup: Setup, clock: LabClock, options: Options, script: Script = NOTHING
) -> EmulatedLab:
    """Return an emulated lab that runs on a clock."""
    wires = MemoryWires(clock)
    emulation = EmulatedLab(lab, setup, script, options, make_loop=VirtualLoop, wires=wires)
    clock.timeline = emulation.timeline
    emulation.__enter__()  # holds nothing that must be released
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
