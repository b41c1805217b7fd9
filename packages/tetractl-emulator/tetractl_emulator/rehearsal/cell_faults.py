"""What may go wrong with the driver, the coils and the cells: rows of the table of faults, and the
world of a dish.
"""

from collections.abc import Iterator
from random import Random
from typing import Any

from tetractl_emulator.rehearsal.picture_faults import SEEN, cell
from tetractl_emulator.rehearsal.schedule import Draw, FaultRow

DRIVER = r"current driver|\bport\b"
DISH = tuple(f"cell {i + 1}" for i in range(6))
"""The cells with a magnet in a dish from which a trial chooses its own."""
SPAN_S = 16.0
"""Latest begin of a fault after the field began to turn [s]: the choice takes half of it."""


def field_rows() -> Iterator[FaultRow]:
    """Yield the rows of driver, coils and cells."""
    answer = f"{DRIVER}|{SEEN}"  # cells that are not steered swim where they want
    yield FaultRow("driver unplugged", "unplug", DRIVER)
    yield FaultRow("driver stuck", "stuck_port", DRIVER)
    yield FaultRow("driver off", "off", answer)
    yield FaultRow("driver resets", "off", answer, lambda d: {"for": d.between(0.01, 1)})
    yield FaultRow("driver silent", "mute", DRIVER)
    yield FaultRow("driver late", "late_driver", answer, lambda d: {"by": d.between(0.005, 1)})
    yield FaultRow("commands doubled", "doubled_commands", r"$.", weight=0.5)
    yield FaultRow("bad bytes", "bad_bytes", answer, lambda d: {"share": d.between(2e-4, 0.5)})
    yield FaultRow(
        "supply low",
        "low_supply",
        answer,
        lambda d: {"millivolts": round(12_000 - 7_000 * d.strength)},
    )
    yield FaultRow("coils hot", "hot", f"°C|{answer}", lambda d: {"celsius": d.between(30, 150)})
    yield FaultRow("coils weak", "weak_coils", SEEN, _weak)
    yield FaultRow("coils turned", "turned_coils", SEEN, lambda d: {"by": d.signed(0.02, 3.1)})
    yield FaultRow("cell divides", "divides", SEEN, cell, at_once=True)
    yield FaultRow("cell rests", "rests", SEEN, cell)
    yield FaultRow(
        "cell dives", "dives", SEEN, lambda d: cell(d) | {"by_um": d.signed(20, 600)}, at_once=True
    )


def dish_world(random: Random, off: float) -> dict[str, Any]:
    """Draw the cells of a dish, of which those named in `DISH` have a magnet."""
    walk = round(random.uniform(0.02, 0.1), 4)
    return {"heading_noise": walk, "cells": len(DISH), "strangers": random.randint(0, 3)}


def _weak(d: Draw) -> dict[str, Any]:
    return {"axis": d.random.choice("xy"), "share": round(1 - d.between(0.02, 2), 4)}
