"""The results of a film, as tables."""

from collections.abc import Sequence

from tetractl.core.table.table import Column, Table, fixed
from tetractl.film.fit_cell import CellSummary
from tetractl.film.follow import Followed
from tetractl.replay.identification.fit import SampleInterval


def interval(decimals: int, value: SampleInterval | None) -> str:
    """Return a value with its 95 % interval as text; "-" for an unknown value."""
    if value is None:
        return "-"
    show = fixed(decimals)
    return f"{show(value.value)} [{show(value.low)}, {show(value.high)}]"


def cell_table(followed: Followed, cells: Sequence[CellSummary]) -> Table:
    """Return the table to print, with one row per cell."""
    known = any(cell.a is not None for cell in cells)
    columns = [
        Column("cell", [cell.cell for cell in cells]),
        Column("from", [cell.since_s for cell in cells], "s", fixed(1)),
        Column("for", [cell.seconds for cell in cells], "s", fixed(1)),
        Column("speed", [interval(0, cell.speed) for cell in cells], "um/s"),
        Column("path", [cell.path_um for cell in cells], "um", fixed(0)),
        Column("sway", [cell.sway_rad for cell in cells], "rad", fixed(2)),
        Column("helix", [cell.helix_hz for cell in cells], "Hz", fixed(1)),
    ]
    if known:
        columns += [
            Column("a", [interval(2, cell.a) for cell in cells], "rad/s"),
            Column("bias", [interval(2, cell.bias) for cell in cells], "rad"),
            Column("magnet", [_yes(cell.magnetised) for cell in cells]),
        ]
    if any(cell.probability < 0.999 for cell in cells):
        columns.append(Column("identity", [cell.probability for cell in cells], "", fixed(2)))
    return Table("Cells, with 95 % intervals", tuple(columns), "\n".join(notes(followed, cells)))


def notes(followed: Followed, cells: Sequence[CellSummary]) -> list[str]:
    """Return remarks on how well the cells of a film were followed, one line each."""
    width, height = followed.size
    look = "bright on dark" if followed.bright else "dark on bright"
    found = [
        f"{followed.pictures} pictures of {width} x {height} px at {followed.rate_hz:g} Hz, "
        f"{followed.um_px:.3g} um/px; cells {look}, contrast {followed.contrast:.0f} grey levels, "
        f"noise {followed.noise:.1f}"
    ]
    found += followed.remarks
    if followed.damaged:
        found.append(f"warning: {followed.damaged} pictures could not be read")
    for pair, probability in followed.doubtful:
        names = ", ".join(map(str, pair))
        found.append(
            f"warning: cells {names} met and are too similar to be distinguished afterwards: "
            f"the assignment chosen has a probability of {100 * probability:.0f} %"
        )
    if any(cell.speed is None for cell in cells):
        found.append("Cells seen for less than 2 s have no speed.")
    return found


def summary_table(cells: Sequence[CellSummary]) -> Table:
    """Return the data table with one row per cell."""

    def ends(name: str, key: str, unit: str) -> list[Column]:
        values = [getattr(cell, name) for cell in cells]
        return [
            Column(f"{key}{end}", [None if v is None else getattr(v, part) for v in values], unit)
            for end, part in (("", "value"), ("_low", "low"), ("_high", "high"))
        ]

    columns = (
        Column("cell", [cell.cell for cell in cells]),
        Column("since", [cell.since_s for cell in cells], "s"),
        Column("duration", [cell.seconds for cell in cells], "s"),
        Column("pictures", [cell.pictures for cell in cells]),
        *ends("speed", "speed", "um/s"),
        Column("path", [cell.path_um for cell in cells], "um"),
        Column("sway", [cell.sway_rad for cell in cells], "rad"),
        Column("helix", [cell.helix_hz for cell in cells], "Hz"),
        Column("helix_radius", [cell.helix_um for cell in cells], "um"),
        *ends("a", "a", "rad/s"),
        *ends("bias", "bias", "rad"),
        Column("magnetised", [cell.magnetised for cell in cells]),
        Column("identity_probability", [cell.probability for cell in cells]),
    )
    return Table("Cells", columns)


def pose_table(followed: Followed) -> Table:
    """Return the data table with one row per cell and picture, which `tetractl identify` also
    reads.
    """
    rows = [
        (
            t,
            int(k),
            f"cell {path.identity}",
            c.x,
            c.y,
            c.heading,
            c.axis,
            c.probability,
            c.found,
            c.merged,
        )
        for path in followed.paths
        for t, k, c in zip(path.times.tolist(), path.frames, path.seen, strict=True)
    ]
    rows.sort(key=lambda row: (row[1], row[2]))
    values = list(zip(*rows, strict=True)) or [()] * 10
    names = (
        ("time", "s"),
        ("picture", ""),
        ("robot", ""),
        ("x", "um"),
        ("y", "um"),
        ("heading", "rad"),
        ("axis", "rad"),
        ("identity_probability", ""),
        ("found", ""),
        ("merged", ""),
    )
    return Table("Poses", tuple(Column(n, v, u) for (n, u), v in zip(names, values, strict=True)))


def as_items(followed: Followed, cells: Sequence[CellSummary]) -> dict:
    """Return the JSON object of --json: the film, and each cell with [low, high] of 95 %
    intervals.
    """

    def value(found: SampleInterval | None) -> dict | None:
        return None if found is None else {"value": found.value, "ci95": [found.low, found.high]}

    return {
        "pictures": followed.pictures,
        "damaged": followed.damaged,
        "rate_hz": followed.rate_hz,
        "um_per_px": followed.um_px,
        "scale_guessed": followed.guessed_scale,
        "organism": followed.organism.name,
        "remarks": list(followed.remarks),
        "bright": followed.bright,
        "contrast": followed.contrast,
        "noise": followed.noise,
        "cells": [
            {
                "cell": cell.cell,
                "since_s": cell.since_s,
                "duration_s": cell.seconds,
                "pictures": cell.pictures,
                "speed_um_s": value(cell.speed),
                "path_um": cell.path_um,
                "sway_rad": cell.sway_rad,
                "helix_hz": cell.helix_hz,
                "helix_um": cell.helix_um,
                "a_rad_s": value(cell.a),
                "bias_rad": value(cell.bias),
                "magnetised": cell.magnetised,
                "identity_probability": cell.probability,
            }
            for cell in cells
        ],
        "indistinguishable": [
            {"cells": list(pair), "probability": probability}
            for pair, probability in followed.doubtful
        ],
    }


def _yes(magnetised: bool | None) -> str:
    return "-" if magnetised is None else "yes" if magnetised else "no"
