"""What may go wrong with a camera's stream of pictures, and with a microscope's: rows of the table
of faults, and the microscope's world.
"""

from collections.abc import Iterator
from random import Random
from typing import Any

from tetractl_emulator.rehearsal.schedule import CELLS, MOTION, PLACE, SIGHT, Draw, FaultRow, Fields

SEEN = rf"{SIGHT}|{MOTION}|{PLACE}|{CELLS}|no picture|damaged|picture is|in view|was the stage"


def stream_rows() -> Iterator[FaultRow]:
    """Yield the rows of each camera that reads a stream of pictures."""
    yield FaultRow("no pictures", "no_frames", SEEN)
    yield FaultRow("picture frozen", "repeat", SEEN)
    yield FaultRow("pictures slow", "half_rate", SEEN, lambda d: {"every": round(d.between(2, 60))})
    yield FaultRow("pictures late", "late_pictures", SEEN, lambda d: {"by": d.between(0.01, 1)})
    yield FaultRow("pictures lost", "bad_pictures", SEEN, _part("lost"))
    yield FaultRow("pictures doubled", "bad_pictures", r"$.", _part("doubled"), weight=0.5)
    yield FaultRow("pictures damaged", "bad_pictures", SEEN, _part("cut", "cut_ended", "oversized"))


def microscope_rows() -> Iterator[FaultRow]:
    """Yield the rows of a microscope above cells, its stream's among them."""
    yield from stream_rows()
    yield FaultRow("dark", "light", SEEN, lambda d: {"share": round(1 / d.between(1.05, 60), 4)})
    yield FaultRow("bright", "light", SEEN, lambda d: {"share": d.between(1.05, 6)})
    yield FaultRow("flicker", "light", SEEN, lambda d: {"flicker": d.between(0.02, 1)})
    yield FaultRow("blurred", "focus", SEEN, lambda d: {"by_um": d.signed(5, 300)})
    yield FaultRow("knocked", "knocked", SEEN, lambda d: {"by_um": d.way(3, 800)})
    yield FaultRow("bubble", "bubble", SEEN, lambda d: {"size_um": d.between(20, 600)})
    yield FaultRow("cell covered", "untracked", SEEN, cell)


def microscope_world(random: Random, off: float) -> dict[str, Any]:
    """Draw the properties of a microscope's pictures."""
    noise = round(random.uniform(2, 6), 2)
    contrast = round(random.uniform(40, 80), 1)
    return {"noise": noise, "contrast": contrast, "specks": random.randint(0, 20)}


def cell(d: Draw) -> dict[str, Any]:
    """Return the field `cell`."""
    return {"cell": d.random.choice(d.names)}


def _part(*how: str) -> Fields:
    return lambda d: {"share": min(1.0, d.between(0.02, 1.3)), "how": d.random.choice(how)}
