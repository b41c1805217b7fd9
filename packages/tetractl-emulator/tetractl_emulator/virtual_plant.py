"""The plant `emulated`: an emulated lab and our side of it, in one process and in virtual time.

Guard, inner loop, camera, actuator, frames, firmware and pictures are those of a run in the lab;
only the wires and the clock differ, so the speed of the computer changes nothing. As in a
simulation, planning takes no virtual time.
"""

import threading
from pkgutil import resolve_name
from typing import Literal

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.setup import Setup
from tetractl.lab.rig import Rig
from tetractl.plant.lab_plant import RigSection


class EmulatedPlantSection(RigSection):
    """A lab that is emulated in virtual time; no device is used."""

    type: Literal["emulated"] = "emulated"

    @property
    def real_time(self) -> bool:
        """False: trials take virtual time and need no operator."""
        return False

    @classmethod
    def clock(cls) -> Clock:
        """Return a clock in virtual time."""
        from tetractl_emulator.virtual_wires import LabClock

        return LabClock()

    def require_devices(self) -> None:
        """Raise SpecError if a device cannot be emulated, AbortError if software is missing."""
        from tetractl_emulator.script import Sides

        Sides.of(self.camera.type, self.actuator.type)

    def rig(
        self,
        setup: Setup,
        clock: Clock,
        seed: np.random.SeedSequence,
        emergency: threading.Event | None = None,
        chosen: bool = False,
    ) -> Rig:
        """Return the rig of a new emulated lab. Trials with the same root seed have the same cells
        in the dish; the trial's `seed` gives everything else.
        """
        from tetractl_emulator.sides import Options
        from tetractl_emulator.virtual_wires import LabClock, started

        assert isinstance(clock, LabClock), "`clock` returned it"
        assert isinstance(seed.entropy, int), "the root seed is one number"
        own = int(seed.generate_state(2)[1])
        options = Options(address=None, seed=own, chosen=chosen, dish=seed.entropy)
        emulation, wake = started(self, setup, clock, options), threading.Event()
        join, ports = emulation.camera.join, emulation.wires.ports
        camera = resolve_name(self.camera.device)(self.camera, setup, clock, wake.set, join)
        actuator = resolve_name(self.actuator.device)(self.actuator, setup, clock, ports)
        rig = Rig(camera, actuator, self.limits, setup, clock, emergency, wake, threaded=False)
        clock.steps.append(rig.loop.turn)
        return rig
