"""Reads the CSV files that Motive, the program of OptiTrack cameras, exports, as rows of poses.

Above the numbers stand a line of settings and rows that say what each column is (versions 1.2 to
1.25 of the format; some lack the words in front, or the row of parents):

    Format Version,1.23,Take Name,drive,...,Rotation Type,Quaternion,Length Units,Meters,...

    ,Type,Rigid Body,...,Rigid Body Marker,...
    ,Name,green,...,green:Marker1,...
    ,ID,9E20...,...
    ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,...
    Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,...

Only rigid bodies are read. Cells are empty where a body was not tracked. Of two vertical axes that
Motive may export, y or z, it is that along which bodies move less. A body is at (x, y) with z up,
(x, -z) with y up; its heading is the direction of its own x axis, as of the camera `optitrack`.
"""

from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Floats
from tetractl.tools.table.csv_rows import CsvRow, csv_entries, csv_lines, is_number, read_csv

FIRST = "Format Version"
"""The first entry of such a file."""
BODY = "Rigid Body"
GLOBAL = "Global"
"""The coordinate space in which bodies are where the cameras see them."""
LENGTH_UNITS = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}
QUATERNION = "Quaternion"
ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
"""Orders of Euler angles."""
HEADER_ROWS = 10
"""Most lines above the numbers."""


def table_rows(path: Path) -> Iterator[CsvRow]:
    """Return the rows of a CSV file: the poses in it if Motive exported it."""
    first = next(csv_lines(path), None)
    is_of_motive = first is not None and first[1].startswith(FIRST)
    return motive_rows(path) if is_of_motive else read_csv(path)


def motive_rows(path: Path) -> Iterator[CsvRow]:
    """Yield the poses of the rigid bodies in a file of Motive; UsageError if it has none."""
    lines = csv_lines(path)
    top = next(lines)[1]
    separator = top[len(FIRST)] if len(top) > len(FIRST) else ","
    settings_row = csv_entries(top, separator)
    settings = dict(zip(settings_row[::2], settings_row[1::2], strict=False))
    space = settings.get("Coordinate Space", GLOBAL)
    if space.lower() != GLOBAL.lower():
        said = f"{path}: Coordinate Space {printable(space)}: positions are those of other bodies"
        raise UsageError(said, f"export in the coordinate space {GLOBAL}")
    unit = _length_unit(path, settings.get("Length Units", ""))
    rotation_type = settings.get("Rotation Type", QUATERNION)
    header: list[list[str]] = []
    for _, line in lines:
        header.append(csv_entries(line, separator))
        if header[-1][0] == "Frame" or len(header) > HEADER_ROWS:
            break
    bodies = _bodies(path, header, 4 if rotation_type == QUATERNION else 3)
    width = len(header[-1])
    rows: list[list[float]] = []
    numbers: list[int] = []
    for number, line in lines:
        entries = csv_entries(line, separator)
        rows.append([_number(path, number, entry) for entry in entries[:width]])
        rows[-1].extend([np.nan] * (width - len(entries)))
        numbers.append(number)
    if not rows:
        raise UsageError(f"{path}: has no rows")
    table = np.array(rows)
    names = list(bodies)
    places = np.stack([table[:, position] for _, position in bodies.values()])
    axes = np.stack(
        [_ahead(path, table[:, rotation], rotation_type) for rotation, _ in bodies.values()]
    )
    is_y_up = _is_y_up(places)
    across = -places[..., 2] if is_y_up else places[..., 1]
    headings = np.arctan2(-axes[..., 2] if is_y_up else axes[..., 1], axes[..., 0])
    for frame, number in enumerate(numbers):
        for body, name in enumerate(names):
            pose = (places[body, frame, 0], across[body, frame], headings[body, frame])
            texts = [repr(float(value)) for value in (table[frame, 1], *pose)]
            keys = ("time_s", f"x_{unit}", f"y_{unit}", "heading_rad")
            yield CsvRow(number, dict(zip(keys, texts, strict=True)) | {"robot": name})


def _length_unit(path: Path, name: str) -> str:
    """Return the unit of positions by its name; UsageError for others."""
    unit = LENGTH_UNITS.get(name.lower())
    if unit is None:
        raise UsageError(
            f"{path}: Length Units {printable(name)}", "export in Meters or Millimeters"
        )
    return unit


def _bodies(
    path: Path, header: Sequence[Sequence[str]], angles: int
) -> dict[str, tuple[list[int], list[int]]]:
    """Return the columns of each rigid body, by its name, of the rows above the numbers: those of
    its rotation, X, Y, Z and perhaps W, and those of its position."""
    if header[-1][0] != "Frame" or len(header) < 4:
        raise UsageError(
            f"{path}: is no whole export of Motive: no row begins with Frame",
            "export it with Header Information",
        )
    types = next((row for row in header if BODY in row), None)
    if types is None:
        raise UsageError(
            f"{path}: names no rigid body", "export it with Rigid Bodies and Header Information"
        )
    names = header[header.index(types) + 1]
    columns: dict[str, dict[tuple[str, str], int]] = {}
    above = zip_longest(types, names, header[-2], header[-1], fillvalue="")
    for column, (kind, name, quantity, axis) in enumerate(above):
        if kind == BODY:
            columns.setdefault(name, {})[quantity, axis] = column
    rotation = [("Rotation", axis) for axis in "XYZW"[:angles]]
    position = [("Position", axis) for axis in "XYZ"]
    bodies: dict[str, tuple[list[int], list[int]]] = {}
    for name, of_body in columns.items():
        if not {*rotation, *position} <= set(of_body):
            raise UsageError(
                f"{path}: rigid body {printable(name)} lacks rotations or positions",
                f"export both, in the coordinate space {GLOBAL}",
            )
        bodies[name] = ([of_body[key] for key in rotation], [of_body[key] for key in position])
    return bodies


def _number(path: Path, line: int, entry: str) -> float:
    """Return the number in an entry, NaN if it is empty."""
    if not entry or entry.count(":") > 1:  # nothing, or a time code
        return np.nan
    if not is_number(entry):
        raise UsageError(f"{path}, line {line}: {printable(entry[:60])} is not a number")
    return float(entry)


def _is_y_up(places: Floats) -> bool:
    """Return whether bodies (N, M, 3) move less along y than along z."""
    spread = np.zeros(3)
    for of_body in places:
        tracked = of_body[np.isfinite(of_body).all(axis=1)]
        if len(tracked):
            spread += tracked.var(axis=0)
    return bool(spread[1] <= spread[2])


def _ahead(path: Path, turned: Floats, rotation_type: str) -> Floats:
    """Return the directions (M, 3) of a body's x axis, NaN where it was not tracked, by its
    quaternions x, y, z, w (M, 4) or Euler angles about X, Y, Z (M, 3) [degrees]."""
    axis = np.full((len(turned), 3), np.nan)
    tracked = np.isfinite(turned).all(axis=1)
    if rotation_type == QUATERNION:
        tracked &= np.abs(np.linalg.norm(turned, axis=1) - 1) < 0.01
        rotations = Rotation.from_quat(turned[tracked])
    elif rotation_type in ORDERS:
        in_order = [turned[tracked, "XYZ".index(letter)] for letter in rotation_type]
        rotations = Rotation.from_euler(rotation_type, np.column_stack(in_order), degrees=True)
    else:
        raise UsageError(
            f"{path}: Rotation Type {printable(rotation_type)}", "export quaternions, or XYZ"
        )
    if tracked.any():
        axis[tracked] = rotations.apply([1.0, 0.0, 0.0])
    return axis
