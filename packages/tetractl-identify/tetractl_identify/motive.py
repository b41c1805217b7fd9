"""Reads the CSV files that Motive, the program of OptiTrack cameras, exports, as rows of poses.

Above the numbers, a file has a line of settings and rows that describe the columns (versions 1.2 to
1.25 of the format; some lack the leading words, or the row of parents):

    Format Version,1.23,Take Name,drive,...,Rotation Type,Quaternion,Length Units,Meters,...

    ,Type,Rigid Body,...,Rigid Body Marker,...
    ,Name,green,...,green:Marker1,...
    ,ID,9E20...,...
    ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,...
    Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,...

Only rigid bodies are read. Cells are empty if a body was not tracked. The vertical axis is y,
Motive's default, or z if bodies move much less along z than along y. With z up, the position of a
body is (x, y). With y up, it is (x, -z). The heading of a body is the direction of its own x axis,
as for the camera `optitrack`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Floats
from tetractl.tools.table.csv_rows import CsvRow, csv_lines, is_number, read_csv, split_entries

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
"""Maximum number of lines above the numbers."""
Z_UP = 0.25
"""Ratio of the variances along z and y from which z is not the vertical axis."""


def table_rows(path: Path) -> Iterator[CsvRow]:
    """Read the rows of a CSV file, in their order.

    If Motive exported the file, its poses are converted to the rows that other files have.
    """
    first = next(csv_lines(path), None)
    is_of_motive = first is not None and first[1].startswith(FIRST)
    return motive_rows(path) if is_of_motive else read_csv(path)


def motive_rows(path: Path) -> Iterator[CsvRow]:
    """Yield the poses of the rigid bodies in a file of Motive.

    The file is read twice, line by line: first to find the vertical axis.

    Raises:
        UsageError: If the file has no rigid bodies, or two of one name.
    """
    take, _ = _open_take(path)
    is_y_up = _is_y_up(path, take)
    take, lines = _open_take(path)
    keys = ("time_s", f"x_{take.unit}", f"y_{take.unit}", "heading_rad")
    for number, entries in _numbers(path, take, lines):
        for name, (rotation, position) in take.bodies.items():
            x, y, z = entries[position]
            ahead = _ahead(path, entries[rotation], take.rotation_type)
            across = -z if is_y_up else y
            aside = -ahead[2] if is_y_up else ahead[1]
            pose = (entries[1], x, across, math.atan2(aside, ahead[0]))
            texts = [repr(float(value)) for value in pose]
            yield CsvRow(number, dict(zip(keys, texts, strict=True)) | {"robot": name})


@dataclass(frozen=True, slots=True)
class _Take:
    """The header of a file that Motive exported.

    Attributes:
        unit: Unit of lengths.
        rotation_type: QUATERNION, or one of ORDERS.
        bodies: Columns of the rotation and of the position of each rigid body, by its name.
        width: Number of columns.
        separator: Character between the entries of a line.
    """

    unit: str
    rotation_type: str
    bodies: dict[str, tuple[list[int], list[int]]]
    width: int
    separator: str


def _open_take(path: Path) -> tuple[_Take, Iterator[tuple[int, str]]]:
    """Read the header of a file from Motive, and return it with the lines below it.

    Coordinates relative to other bodies, and an unknown length unit, are a `UsageError`.
    """
    lines = csv_lines(path)
    top = next(lines)[1]
    separator = top[len(FIRST)] if len(top) > len(FIRST) else ","
    settings_row = split_entries(top, separator)
    settings = dict(zip(settings_row[::2], settings_row[1::2], strict=False))
    space = settings.get("Coordinate Space", GLOBAL)
    if space.lower() != GLOBAL.lower():
        said = (
            f"{path}: the Coordinate Space is {printable(space)}, so positions are relative "
            "to other bodies"
        )
        raise UsageError(said, f"export again from Motive, with the coordinate space {GLOBAL}")
    unit = _length_unit(path, settings.get("Length Units", ""))
    rotation_type = settings.get("Rotation Type", QUATERNION)
    header: list[list[str]] = []
    for _, line in lines:
        header.append(split_entries(line, separator))
        if header[-1][0] == "Frame" or len(header) > HEADER_ROWS:
            break
    bodies = _bodies(path, header, 4 if rotation_type == QUATERNION else 3)
    return _Take(unit, rotation_type, bodies, len(header[-1]), separator), lines


def _numbers(
    path: Path, take: _Take, lines: Iterator[tuple[int, str]]
) -> Iterator[tuple[int, Floats]]:
    """Yield the number of each line with its entries (W,). Empty entries are NaN.

    Raises:
        UsageError: If there are no lines.
    """
    is_empty = True
    for number, line in lines:
        is_empty = False
        texts = split_entries(line, take.separator)[: take.width]
        entries = np.full(take.width, np.nan)
        entries[: len(texts)] = [_number(path, number, text) for text in texts]
        yield number, entries
    if is_empty:
        raise UsageError(f"{path}: the file has no rows of data")


def _length_unit(path: Path, name: str) -> str:
    """Convert Motive's name of a length unit to the unit of positions.

    Raises:
        UsageError: If the unit is unknown.
    """
    unit = LENGTH_UNITS.get(name.lower())
    if unit is None:
        raise UsageError(
            f"{path}: the Length Units are {printable(name)}, which cannot be read",
            "export again from Motive, with the length unit Meters or Millimeters",
        )
    return unit


def _bodies(
    path: Path, header: Sequence[Sequence[str]], angles: int
) -> dict[str, tuple[list[int], list[int]]]:
    """Find the columns of each rigid body in the rows above the numbers, by the body's name.

    The columns are those of the rotation (X, Y, Z and, for quaternions, W) and of the position.
    """
    if header[-1][0] != "Frame" or len(header) < 4:
        raise UsageError(
            f"{path}: this is not a complete export from Motive, because no row begins with Frame",
            "export again from Motive, with Header Information",
        )
    types = next((row for row in header if BODY in row), None)
    if types is None:
        raise UsageError(
            f"{path}: the file names no rigid body",
            "export again from Motive, with Rigid Bodies and Header Information",
        )
    names = header[header.index(types) + 1]
    columns: dict[str, dict[tuple[str, str], int]] = {}
    twice: set[str] = set()
    above = zip_longest(types, names, header[-2], header[-1], fillvalue="")
    for column, (kind, name, quantity, axis) in enumerate(above):
        if kind != BODY:
            continue
        of_body = columns.setdefault(name, {})
        if (quantity, axis) in of_body:
            twice.add(name)
        of_body[quantity, axis] = column
    rotation = [("Rotation", axis) for axis in "XYZW"[:angles]]
    position = [("Position", axis) for axis in "XYZ"]
    bodies: dict[str, tuple[list[int], list[int]]] = {}
    for name, of_body in columns.items():
        if not {*rotation, *position} <= set(of_body):
            raise UsageError(
                f"{path}: the file lacks the rotations or positions of the rigid body "
                f"{printable(name)}",
                f"export both from Motive, with the coordinate space {GLOBAL}",
            )
        if name in twice:
            raise UsageError(
                f"{path}: two rigid bodies have the same name, {printable(name)}",
                "give each rigid body its own name in Motive, and export again",
            )
        bodies[name] = ([of_body[key] for key in rotation], [of_body[key] for key in position])
    return bodies


def _number(path: Path, line: int, entry: str) -> float:
    """Read the number in an entry. NaN if the entry is empty or a time code.

    Any other text is a `UsageError`, which names the file and the line.
    """
    if not entry or entry.count(":") > 1:  # nothing, or a time code
        return np.nan
    if not is_number(entry):
        raise UsageError(f"{path}, line {line}: {printable(entry[:60])} is not a number")
    return float(entry)


def _is_y_up(path: Path, take: _Take) -> bool:
    """Check whether y is the vertical axis, which is Motive's default.

    If bodies move much less along z than along y, z is the vertical axis.
    """
    counts = np.zeros(len(take.bodies))
    first = np.zeros((len(take.bodies), 3))
    sums = np.zeros((len(take.bodies), 3))
    squares = np.zeros((len(take.bodies), 3))
    _, lines = _open_take(path)
    for _, entries in _numbers(path, take, lines):
        for body, (_, position) in enumerate(take.bodies.values()):
            place = entries[position]
            if not np.isfinite(place).all():
                continue
            if counts[body] == 0:
                first[body] = place
            counts[body] += 1
            sums[body] += place - first[body]
            squares[body] += (place - first[body]) ** 2
    counts = np.maximum(counts, 1)[:, None]
    spread = np.maximum(squares / counts - (sums / counts) ** 2, 0.0).sum(axis=0)
    return bool(spread[2] >= Z_UP * spread[1])


def _ahead(path: Path, turned: Floats, rotation_type: str) -> Floats:
    """Compute the direction of a body's x axis, shape (3,). NaN if it was not tracked.

    Args:
        path: The file, for messages.
        turned: A quaternion x, y, z, w, or Euler angles about X, Y, Z [degrees].
        rotation_type: QUATERNION, or one of ORDERS.
    """
    if rotation_type != QUATERNION and rotation_type not in ORDERS:
        raise UsageError(
            f"{path}: the Rotation Type is {printable(rotation_type)}, which cannot be read",
            "export again from Motive, with rotations as quaternions or XYZ",
        )
    if not np.isfinite(turned).all():
        return np.full(3, np.nan)
    if rotation_type == QUATERNION:
        x, y, z, w = turned.tolist()
        if abs(math.hypot(x, y, z, w) - 1) >= 0.01:
            return np.full(3, np.nan)
        return np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])
    in_order = [turned["XYZ".index(letter)] for letter in rotation_type]
    rotation = Rotation.from_euler(rotation_type, in_order, degrees=True)
    return np.asarray(rotation.apply([1.0, 0.0, 0.0]))
