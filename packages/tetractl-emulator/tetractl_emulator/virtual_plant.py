"""The plant `emulated`: an emulated lab and our side of it, in one process and in virtual time.

The guard, inner loop, camera, actuator, frames, firmware and images are the same as in a run in the
lab. Only the connections and the clock differ, so the speed of the computer does not change the
result. As in a simulation, planning takes no virtual time unless a fault of the script adds it.
"""

import threading
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Action, Command
from tetractl.core.errors import AbortError, UsageError
from tetractl.core.protocols import LabSupervision
from tetractl.core.setup import Setup
from tetractl.core.trial import EMULATED_DEVICES_FACT, REAL_DEVICE_FACT, PlantInfo
from tetractl.lab.rig import Rig
from tetractl.plant.lab_plant import LabPlant, RigSection


class EmulatedPlantSection(RigSection):
    """A lab that is emulated in virtual time. No device is used unless `real` names one."""

    type: Literal["emulated"] = "emulated"
    faults: str | dict[str, Any] | None = None
    """A script of faults, as for `tetractl lab emulate --script`: a file, relative to the spec, or
    the script itself.
    """
    real: Literal["camera", "actuator"] | None = None
    """The device that is real, in real time: a camera above robots that are switched off, while
    emulated robots drive in their place, or an actuator with robots that drive on blocks, while an
    emulated camera shows emulated robots.
    """
    record: str | None = Field(default=None, min_length=1, exclude=True)
    """A folder for what truly happens in each trial, as JSON lines in `truth-000.jsonl` and so on,
    as for `tetractl lab emulate --record`. It is not part of the spec in the log.
    """

    @property
    def real_time(self) -> bool:
        """Whether a device is real. If not, trials run in virtual time and need no operator."""
        return self.real is not None

    def bounds(self) -> dict[str, str]:
        """Describe the lab's limits for display, and which device is real, if there is one."""
        return super().bounds() | self.halves()

    def halves(self) -> dict[str, str]:
        """Describe which device is real and which is emulated.

        Returns:
            The facts REAL_DEVICE_FACT and EMULATED_DEVICES_FACT. Empty if both devices are
            emulated.
        """
        if self.real is None:
            return {}
        return {
            REAL_DEVICE_FACT: self.real,
            EMULATED_DEVICES_FACT: ", ".join(self.emulated_devices),
        }

    @property
    def emulated_devices(self) -> tuple[str, ...]:
        """The names of the emulated devices: "camera", "actuator" or both."""
        return tuple(name for name in ("camera", "actuator") if name != self.real)

    def clock(self) -> Clock:
        """Create the clock on which this section's labs run.

        It is in virtual time, or in real time if a device is real.
        """
        from tetractl_emulator.virtual_lab import LabClock, LiveClock

        return LiveClock() if self.real else LabClock()

    def with_files(self, folder: Path | None) -> Self:
        """Return a copy with the content of the script in place of its file's name.

        Args:
            folder: Folder of the spec. None for the current folder.

        Raises:
            InvalidSpecError: If the script is invalid.
        """
        from tetractl.spec.yaml.document import read_document
        from tetractl.spec.yaml.spec_files import resolve_path
        from tetractl_emulator.script import load_script

        if not isinstance(self.faults, str):
            return self
        path = resolve_path(folder, "lab.faults", self.faults)
        load_script(path, self.camera.type, self.actuator.type)
        return self.model_copy(update={"faults": read_document(path).data})

    def require_devices(self) -> None:
        """Check that the devices can be emulated, or opened if they are real.

        Raises:
            SpecError: If a device cannot be emulated.
            AbortError: If software is missing.
        """
        from tetractl_emulator.script import DeviceClasses

        DeviceClasses.of_types(self.camera.type, self.actuator.type)
        if self.real == "actuator":
            self.actuator.require_port()

    def require_calibratable(self) -> None:
        """Check that robots can be calibrated on this plant.

        Raises:
            UsageError: If the actuator is real, because the camera shows emulated robots.
        """
        if self.real == "actuator":
            raise UsageError(
                "plant.real=actuator makes the robots real, but the emulated camera does not "
                "show real robots: they cannot be calibrated",
                "calibrate real robots with --plant lab",
            )

    def rig(
        self,
        setup: Setup,
        clock: Clock,
        seed: np.random.SeedSequence,
        supervision: LabSupervision | None = None,
        chosen: bool = False,
    ) -> Rig:
        """Create the connected lab of a new emulation; see `RigSection.rig`.

        Trials with the same root seed have the same cells in the dish. Everything else depends on
        the trial's `seed`.

        Args:
            setup: The constants of the experiment.
            clock: The clock that this section's method `clock` has created.
            seed: Seed of the trial.
            supervision: The supervision of the trial. None if nobody supervises it.
            chosen: Whether the trial chooses its robots among the cells in the dish.

        Raises:
            AbortError: If `real` is set and the lab's devices cannot be real and emulated one by
                one.
        """
        from tetractl.spec.yaml.core_yaml import format_yaml
        from tetractl_emulator.half_real import Blind, MovedCamera, TwinActuator
        from tetractl_emulator.script import NO_FAULTS, parse_script
        from tetractl_emulator.sides import Options
        from tetractl_emulator.virtual_lab import (
            LabClock,
            LiveClock,
            continue_and_close,
            start_emulated_lab,
        )

        assert isinstance(clock, LabClock), "`clock` returned it"
        assert isinstance(seed.entropy, int), "the root seed is one number"
        watched = supervision or LabSupervision()
        own_seed = int(seed.generate_state(2)[1])
        record = None
        if self.record is not None and seed.spawn_key:
            record = Path(self.record) / f"truth-{seed.spawn_key[0]:03d}.jsonl"
            record.parent.mkdir(parents=True, exist_ok=True)
        options = Options(
            address=None,
            seed=own_seed,
            record=record,
            trials_choose_robots=chosen,
            dish_seed=seed.entropy,
        )
        faults = self.with_files(Path()).faults
        types = self.camera.type, self.actuator.type
        script = NO_FAULTS
        if isinstance(faults, dict):
            script = parse_script(format_yaml(faults), "plant.faults", *types)
        has_cells = chosen or self.actuator.type == "field"
        if self.real and (has_cells or self.camera.type == self.actuator.type):
            names = " and ".join(types)
            raise AbortError(
                f"{names}: one of these devices cannot be real while the other is emulated"
            )
        stand_in_camera = Blind() if self.real == "camera" else None
        wake = threading.Event()
        emulation = start_emulated_lab(
            self, setup, clock, options, script, watched, stand_in_camera
        )
        join = emulation.camera.join
        ports = emulation.wires.ports
        actuator = resolve_name(self.actuator.device)(self.actuator, setup, clock, ports)
        if self.real == "camera":
            real = self.camera.build(setup, clock, wake.set)
            camera = MovedCamera(real, emulation, clock, setup.metres * 1000)
            clock.steps.append(camera.look)
        else:
            camera = resolve_name(self.camera.device)(self.camera, setup, clock, wake.set, join)
        if self.real == "actuator":
            actuator = TwinActuator(self.actuator.build(setup, clock), actuator)
        live = isinstance(clock, LiveClock)
        devices = camera, actuator, self.limits, setup, clock
        emulated = self.emulated_devices
        rig = Rig(
            *devices,
            watched.emergency,
            wake,
            threaded=live,
            emulated=emulated,
            checks_of=resolve_name(self.actuator.checks),
        )
        if live:
            rig.call_after_close(clock.start())
        else:
            clock.steps.append(rig.loop.step_if_due)
        if record is not None:
            clock.watchers.append(
                lambda: emulation.note_guard_state(rig.loop.guard.state, rig.loop.guard.reason)
            )
            rig.call_after_close(lambda: continue_and_close(emulation))
        return rig

    def plant(self, rig: Rig, supervision: LabSupervision) -> LabPlant:
        """Create the plant of a connected lab. Faults can make its planning take virtual time."""
        return BusyPlant(rig, supervision, self.type, self.halves())


class BusyPlant(LabPlant):
    """A `LabPlant` in virtual time, in which a fault can make the computer slow.

    If the fault `busy` acts, time passes between a frame and the action that is planned from it.

    Args:
        rig: The connected lab.
        supervision: The supervision of the trial.
        kind: Type of the plant, for the log.
        halves: Which device is real and which is emulated, for the log.
    """

    def __init__(
        self, rig: Rig, supervision: LabSupervision, kind: str, halves: dict[str, str]
    ) -> None:
        super().__init__(rig, supervision, kind)
        self._halves = halves
        self._plans = 0

    def open(self) -> PlantInfo:
        """Open the lab, and return its facts together with `halves`."""
        info = super().open()
        return replace(info, facts={**info.facts, **self._halves})

    def send(self, action: Action) -> Command:
        """Let the computing time of a `busy` fault pass, then send an action.

        No time passes before the first observation. A fault acts only on every `every`-th action.
        """
        from tetractl_emulator.virtual_lab import LabClock

        assert isinstance(self.clock, LabClock), "the section returned it"
        self._plans += 1
        for busy in tuple(self.clock.acting.of_kind("busy")):
            if self._observed_ns is not None and self._plans % busy.every == 0:
                self.clock.sleep_until(self.clock.now() + round(busy.seconds * SECOND))
        command = super().send(action)
        if not self._halves:  # else they look from the thread that makes the steps
            self.clock.watch()
        return command
