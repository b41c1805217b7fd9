"""The plant `emulated`: an emulated lab and our side of it, in one process and in virtual time.

Guard, inner loop, camera, actuator, frames, firmware and pictures are those of a run in the lab;
only the wires and the clock differ, so the speed of the computer changes nothing. As in a
simulation, planning takes no virtual time, unless a fault of its script says so.
"""

import threading
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Action, Command
from tetractl.core.protocols import LabSupervision
from tetractl.core.setup import Setup
from tetractl.lab.rig import Rig
from tetractl.plant.lab_plant import LabPlant, RigSection


class EmulatedPlantSection(RigSection):
    """A lab that is emulated in virtual time; no device is used."""

    type: Literal["emulated"] = "emulated"
    faults: str | dict[str, Any] | None = None
    """A script of faults, as of `tetractl lab emulate --script`: a file, relative to the spec, or
    the script itself."""
    record: str | None = Field(default=None, min_length=1, exclude=True)
    """A folder for what truly happens in each trial, as JSON lines in `truth-000.jsonl` ..., as of
    `tetractl lab emulate --record`; it is not part of the spec in the log."""

    @property
    def real_time(self) -> bool:
        """False: trials take virtual time and need no operator."""
        return False

    @classmethod
    def clock(cls) -> Clock:
        """Return a clock in virtual time."""
        from tetractl_emulator.virtual_wires import LabClock

        return LabClock()

    def with_files(self, folder: Path) -> Self:
        """Return the section with the script in place of its file's name."""
        from tetractl.experiment.yaml.document import parse_document, read_text
        from tetractl_emulator.script import load_script

        if not isinstance(self.faults, str):
            return self
        path = folder / self.faults
        load_script(path, self.camera.type, self.actuator.type)
        return self.model_copy(update={"faults": parse_document(read_text(path), "").data})

    def require_devices(self) -> None:
        """Raise SpecError if a device cannot be emulated, AbortError if software is missing."""
        from tetractl_emulator.script import Sides

        Sides.of(self.camera.type, self.actuator.type)

    def rig(
        self,
        setup: Setup,
        clock: Clock,
        seed: np.random.SeedSequence,
        supervision: LabSupervision | None = None,
        chosen: bool = False,
    ) -> Rig:
        """Return the rig of a new emulated lab. Trials with the same root seed have the same cells
        in the dish; the trial's `seed` gives everything else.
        """
        from tetractl_emulator.script import NOTHING, script_of
        from tetractl_emulator.sides import Options
        from tetractl_emulator.virtual_wires import LabClock, outlive, started

        assert isinstance(clock, LabClock), "`clock` returned it"
        assert isinstance(seed.entropy, int), "the root seed is one number"
        watched = supervision or LabSupervision()
        own = int(seed.generate_state(2)[1])
        record = None
        if self.record is not None and seed.spawn_key:
            record = Path(self.record) / f"truth-{seed.spawn_key[0]:03d}.jsonl"
            record.parent.mkdir(parents=True, exist_ok=True)
        options = Options(address=None, seed=own, record=record, chosen=chosen, dish=seed.entropy)
        faults = self.with_files(Path()).faults
        types = self.camera.type, self.actuator.type
        script = script_of(faults, *types) if isinstance(faults, dict) else NOTHING
        emulation, wake = started(self, setup, clock, options, script, watched), threading.Event()
        join, ports = emulation.camera.join, emulation.wires.ports
        camera = resolve_name(self.camera.device)(self.camera, setup, clock, wake.set, join)
        actuator = resolve_name(self.actuator.device)(self.actuator, setup, clock, ports)
        rig = Rig(
            camera, actuator, self.limits, setup, clock, watched.emergency, wake, threaded=False
        )
        clock.steps.append(rig.loop.turn)
        if record is not None:
            clock.steps.append(lambda: emulation.ruled(rig.guard.state, rig.guard.reason))
            rig.after_close(lambda: outlive(emulation))
        return rig

    def plant(self, rig: Rig, supervision: LabSupervision) -> LabPlant:
        """Return the plant of a rig, on whose clock planning may take time."""
        return BusyPlant(rig, supervision, self.type)


class BusyPlant(LabPlant):
    """A `LabPlant` in virtual time: between a frame and the action that is planned from it, the
    clock's `plan_s` [s] passes.
    """

    def send(self, action: Action) -> Command:
        """Let the time of the plan pass, and hold an action."""
        from tetractl_emulator.virtual_wires import LabClock

        assert isinstance(self.clock, LabClock), "the section returned it"
        if self._observed_ns is not None and self.clock.plan_s:
            self.clock.sleep_until(self.clock.now() + round(self.clock.plan_s * SECOND))
        return super().send(action)
