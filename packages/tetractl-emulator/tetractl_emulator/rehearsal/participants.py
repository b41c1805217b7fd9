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
from tetractl_emulator.rehearsal.schedule import KINDS, SPAN_S, Draw, FaultRow
from tetractl_emulator.script import Sides

SectionDraw = Callable[[Random, float], dict[str, Any]]
"""Draws a side's section of `emulation`, in which a wheel is slower by a share `off`, more than the
spec allows, if that is not 0."""


def _as_in_the_spec(random: Random, off: float) -> dict[str, Any]:
    return {}


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """A side's part: `rows` for its own faults, which replace the table's of the same fault, and
    the draw of its `world`. An actuator of cells also names those of a dish from which trials
    choose, `dish`, with the latest begin of a fault, `span_s` [s].
    """

    rows: Sequence[FaultRow] = ()
    world: SectionDraw = _as_in_the_spec
    dish: tuple[str, ...] = ()
    span_s: float = SPAN_S


@dataclass(frozen=True, slots=True)
class LabRehearsal:
    """The rows of all faults that a lab can have, and the draws for camera and actuator; the names
    of the robots or cells that faults may name; whether robots are `placed` on their starts; the
    `scale` of lengths.
    """

    kinds: Sequence[FaultRow]
    camera: SectionDraw
    actuator: SectionDraw
    names: tuple[str, ...]
    placed: bool
    start_mm: float
    span_s: float
    scale: float = 1.0


def scale_of(lab: LabSection, setup: Setup) -> float:
    """Return the scale in which lengths, drawn for robots of 200 mm/s, are drawn for a lab: that of
    their speeds for cells, 1 for all robots on wheels.
    """
    fastest_mm_s = float(setup.speed.max()) * setup.metres * 1000
    return fastest_mm_s / 200 if lab.actuator.type == "field" else 1.0


def rehearsal_of(lab: LabSection, setup: Setup, chosen: bool = False) -> LabRehearsal:
    """Return what a lab can be rehearsed against; `chosen`: whether trials choose their robots."""
    sides = Sides.of(lab.camera.type, lab.actuator.type)
    camera, actuator = (
        side.rehearsal(lab, setup) if hasattr(side, "rehearsal") else Rehearsal()
        for side in (sides.camera, sides.actuator)
    )
    rows = [*camera.rows, *actuator.rows]
    names = sides.faults.keys() - {row.fault for row in rows}
    kinds = [row for row in KINDS if row.fault in names]
    if len(setup.names) < 2:
        kinds = [row for row in kinds if row.fields is not Draw.robots]
    names = actuator.dish if chosen else setup.names
    start_mm = lab.limits.start_mm
    world = (camera.world, actuator.world)
    span_s = actuator.span_s if chosen else SPAN_S
    own_names = names, not chosen, start_mm, span_s, scale_of(lab, setup)
    return LabRehearsal([*rows, *kinds], *world, *own_names)
