"""What a camera or an actuator adds to rehearsals: the rows of its own faults, and its world.

An emulated side of your own takes part in the faults of the table that it can have, by their names.
It may have a class method `rehearsal(lab, setup)`, which returns a `Rehearsal`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

from tetractl.core.setup import Setup
from tetractl.experiment.lab_section import LabSection
from tetractl_emulator.rehearsal.schedule import KINDS, Draw, FaultRow
from tetractl_emulator.script import Sides

SectionDraw = Callable[[Random, bool], dict[str, Any]]
"""Draws a side's section of `emulation`, in which a wheel is `off` by more than the spec allows."""


def _as_in_the_spec(random: Random, off: bool) -> dict[str, Any]:
    return {}


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """A side's part: `rows` for its own faults, which replace the table's of the same fault, and
    the draw of its `world`.
    """

    rows: Sequence[FaultRow] = ()
    world: SectionDraw = _as_in_the_spec


@dataclass(frozen=True, slots=True)
class LabRehearsal:
    """The rows of all faults that a lab can have, and the draws for camera and actuator."""

    kinds: Sequence[FaultRow]
    camera: SectionDraw
    actuator: SectionDraw


def rehearsal_of(lab: LabSection, setup: Setup) -> LabRehearsal:
    """Return what a lab can be rehearsed against."""
    sides = Sides.of(lab.camera.type, lab.actuator.type)
    camera, actuator = (
        side.rehearsal(lab, setup) if hasattr(side, "rehearsal") else Rehearsal()
        for side in (sides.camera, sides.actuator)
    )
    own = [*camera.rows, *actuator.rows]
    names = sides.faults.keys() - {row.fault for row in own}
    kinds = [row for row in KINDS if row.fault in names]
    if len(setup.names) < 2:
        kinds = [row for row in kinds if row.fields is not Draw.robots]
    return LabRehearsal([*own, *kinds], camera.world, actuator.world)
