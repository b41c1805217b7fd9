"""The emulated microscope and our camera of cells on one virtual clock, and trials with them.

Pictures are synthetic. Command line, plant, guard, inner loop, actuator, driver, coils, cells,
pictures, JPEG parts and tracking are the real ones; threads, sockets and the clock are not.
"""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from support.needs_opencv import cv2
from support.paths import ROOT
from support.virtual_wires import PatientClock, virtual_wires

from tetractl.core.clock import SECOND
from tetractl.emulate.emulated_lab import EmulatedLab
from tetractl.emulate.script import NOTHING, parse_script
from tetractl.emulate.sides import Options
from tetractl.emulate.virtual_wires import started
from tetractl.experiment.load import LoadedSpec, load_spec
from tetractl.experiment.plants import lab_of, on_plant
from tetractl.lab.cameras.cells.camera import CellCamera
from tetractl.lab.cameras.cells.section import CellsSection

cv2.setNumThreads(1)
DISH = ROOT / "experiments" / "tetrahymena_dish.yaml"
BEFORE_NS = SECOND // 2  # the lab is up that long before anything connects


class JoinedCells:
    """Our camera of cells on the present dish: the `device` of a section."""

    dish: EmulatedLab

    def __new__(cls, section, setup, clock, wake):
        return CellCamera(section, setup, clock, wake, cls.dish.camera.camera.join)


@dataclass
class VirtualDish:
    """An emulated dish; `spec` leads to it."""

    emulation: EmulatedLab
    clock: PatientClock
    spec: LoadedSpec
    sets: tuple

    @property
    def cells(self):
        """The cells as they truly are."""
        return self.emulation.actuator.bodies[0].dish.cells


@contextlib.contextmanager
def virtual_dish(folder, seed=1, sets=(), script="", spec=DISH):
    """An emulated dish with a microscope in virtual time; `script` is YAML."""
    coils = Path(folder) / "coils"
    sets = (f"trials.seed={seed}", f"lab.actuator.port={coils}", *sets)
    loaded = load_spec(spec, sets)
    lab = lab_of(loaded.experiment, loaded.name)
    play = parse_script("about: a test\n" + script, "script", "cells", "field")
    options = Options(link=coils, seed=seed, chosen=loaded.experiment.open)
    clock = PatientClock()
    emulation = started(lab, loaded.experiment.setup, clock, options, play or NOTHING)
    JoinedCells.dish = emulation
    device = f"{__name__}:{JoinedCells.__name__}"
    with (
        virtual_wires(emulation.wires, clock),
        mock.patch.object(CellsSection, "device", device),
    ):
        clock.sleep_until(BEFORE_NS)
        yield VirtualDish(emulation, clock, on_plant(loaded, "lab"), sets)
