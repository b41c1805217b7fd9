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
EULER_ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
"""Orders of Euler angles."""
HEADER_ROWS_MAX = 10
"""Maximum number of lines above the numbers."""
Z_VARIANCE_RATIO_MIN = 0.25
"""Ratio of the variances along z and y from which z is not the vertical axis."""


def read_table_rows(path: Path) -> Iterator[CsvRow]:
    """Read the rows of a CSV file, in their order.

    If Motive exported the file, its poses are converted to the rows that other files have.
    """
    first_line = next(csv_lines(path), None)
    is_from_motive = first_line is not None and first_line[1].startswith(FIRST)
    return read_motive_rows(path) if is_from_motive else read_csv(path)


def read_motive_rows(path: Path) -> Iterator[CsvRow]:
    """Yield the poses of the rigid bodies in a file of Motive.

    The file is read twice, line by line: first to find the vertical axis.

    Raises:
        UsageError: If the file has no rigid bodies, or two of one name.
    """
    header, _ = _open_motive_file(path)
    is_y_up = _is_y_up(path, header)
    header, lines = _open_motive_file(path)
    columns = ("time_s", f"x_{header.unit}", f"y_{header.unit}", "heading_rad")
    for line_number, numbers in _numbers(path, header, lines):
        for name, (rotation, position) in header.bodies.items():
            x, y, z = numbers[position]
            ahead = _compute_x_axis(path, numbers[rotation], header.rotation_type)
            y_table = -z if is_y_up else y
            ahead_y = -ahead[2] if is_y_up else ahead[1]
            pose = (numbers[1], x, y_table, math.atan2(ahead_y, ahead[0]))
            cells = [repr(float(value)) for value in pose]
            yield CsvRow(line_number, dict(zip(columns, cells, strict=True)) | {"robot": name})


@dataclass(frozen=True, slots=True)
class _MotiveHeader:
    """The header of a file that Motive exported.

    Attributes:
        unit: Unit of lengths.
        rotation_type: QUATERNION, or one of EULER_ORDERS.
        bodies: Columns of the rotation and of the position of each rigid body, by its name.
        width: Number of columns.
        separator: Character between the entries of a line.
    """

    unit: str
    rotation_type: str
    bodies: dict[str, tuple[list[int], list[int]]]
    width: int
    separator: str


def _open_motive_file(path: Path) -> tuple[_MotiveHeader, Iterator[tuple[int, str]]]:
    """Read the header of a file from Motive, and return it with the lines below it.

    Coordinates relative to other bodies, and an unknown length unit, are a `UsageError`.
    """
    lines = csv_lines(path)
    settings_line = next(lines)[1]
    separator = settings_line[len(FIRST)] if len(settings_line) > len(FIRST) else ","
    settings_row = split_entries(settings_line, separator)
    settings = dict(zip(settings_row[::2], settings_row[1::2], strict=False))
    space = settings.get("Coordinate Space", GLOBAL)
    if space.lower() != GLOBAL.lower():
        message = (
            f"{path}: the Coordinate Space is {printable(space)}, so positions are relative "
            "to other bodies"
        )
        raise UsageError(message, f"export again from Motive, with the coordinate space {GLOBAL}")
    unit = _parse_length_unit(path, settings.get("Length Units", ""))
    rotation_type = settings.get("Rotation Type", QUATERNION)
    header_rows: list[list[str]] = []
    for _, line in lines:
        header_rows.append(split_entries(line, separator))
        if header_rows[-1][0] == "Frame" or len(header_rows) > HEADER_ROWS_MAX:
            break
    bodies = _find_body_columns(path, header_rows, 4 if rotation_type == QUATERNION else 3)
    return _MotiveHeader(unit, rotation_type, bodies, len(header_rows[-1]), separator), lines


def _numbers(
    path: Path, header: _MotiveHeader, lines: Iterator[tuple[int, str]]
) -> Iterator[tuple[int, Floats]]:
    """Yield the number of each line with its entries (W,). Empty entries are NaN.

    Raises:
        UsageError: If there are no lines.
    """
    is_empty = True
    for line_number, line in lines:
        is_empty = False
        entries = split_entries(line, header.separator)[: header.width]
        numbers = np.full(header.width, np.nan)
        numbers[: len(entries)] = [_number(path, line_number, text) for text in entries]
        yield line_number, numbers
    if is_empty:
        raise UsageError(f"{path}: the file has no rows of data")


def _parse_length_unit(path: Path, name: str) -> str:
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


def _find_body_columns(
    path: Path, header_rows: Sequence[Sequence[str]], n_angles: int
) -> dict[str, tuple[list[int], list[int]]]:
    """Find the columns of each rigid body in the rows above the numbers, by the body's name.

    The columns are those of the rotation (X, Y, Z and, for quaternions, W) and of the position.
    """
    if header_rows[-1][0] != "Frame" or len(header_rows) < 4:
        raise UsageError(
            f"{path}: this is not a complete export from Motive, because no row begins with Frame",
            "export again from Motive, with Header Information",
        )
    types = next((row for row in header_rows if BODY in row), None)
    if types is None:
        raise UsageError(
            f"{path}: the file names no rigid body",
            "export again from Motive, with Rigid Bodies and Header Information",
        )
    names = header_rows[header_rows.index(types) + 1]
    columns_by_body: dict[str, dict[tuple[str, str], int]] = {}
    repeated_names: set[str] = set()
    column_headings = zip_longest(types, names, header_rows[-2], header_rows[-1], fillvalue="")
    for column, (column_type, name, quantity, axis) in enumerate(column_headings):
        if column_type != BODY:
            continue
        body_columns = columns_by_body.setdefault(name, {})
        if (quantity, axis) in body_columns:
            repeated_names.add(name)
        body_columns[quantity, axis] = column
    rotation = [("Rotation", axis) for axis in "XYZW"[:n_angles]]
    position = [("Position", axis) for axis in "XYZ"]
    bodies: dict[str, tuple[list[int], list[int]]] = {}
    for name, body_columns in columns_by_body.items():
        if not {*rotation, *position} <= set(body_columns):
            raise UsageError(
                f"{path}: the file lacks the rotations or positions of the rigid body "
                f"{printable(name)}",
                f"export both from Motive, with the coordinate space {GLOBAL}",
            )
        if name in repeated_names:
            raise UsageError(
                f"{path}: two rigid bodies have the same name, {printable(name)}",
                "give each rigid body its own name in Motive, and export again",
            )
        bodies[name] = (
            [body_columns[key] for key in rotation],
            [body_columns[key] for key in position],
        )
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


def _is_y_up(path: Path, header: _MotiveHeader) -> bool:
    """Check whether y is the vertical axis, which is Motive's default.

    If bodies move much less along z than along y, z is the vertical axis.
    """
    counts = np.zeros(len(header.bodies))
    first_positions = np.zeros((len(header.bodies), 3))
    sums = np.zeros((len(header.bodies), 3))
    square_sums = np.zeros((len(header.bodies), 3))
    _, lines = _open_motive_file(path)
    for _, numbers in _numbers(path, header, lines):
        for body, (_, position) in enumerate(header.bodies.values()):
            body_position = numbers[position]
            if not np.isfinite(body_position).all():
                continue
            if counts[body] == 0:
                first_positions[body] = body_position
            counts[body] += 1
            sums[body] += body_position - first_positions[body]
            square_sums[body] += (body_position - first_positions[body]) ** 2
    counts = np.maximum(counts, 1)[:, None]
    variances = np.maximum(square_sums / counts - (sums / counts) ** 2, 0.0).sum(axis=0)
    return bool(variances[2] >= Z_VARIANCE_RATIO_MIN * variances[1])


def _compute_x_axis(path: Path, rotation_numbers: Floats, rotation_type: str) -> Floats:
    """Compute the direction of a body's x axis, shape (3,). NaN if it was not tracked.

    Args:
        path: The file, for messages.
        rotation_numbers: A quaternion x, y, z, w, or Euler angles about X, Y, Z [degrees].
        rotation_type: QUATERNION, or one of EULER_ORDERS.
    """
    if rotation_type != QUATERNION and rotation_type not in EULER_ORDERS:
        raise UsageError(
            f"{path}: the Rotation Type is {printable(rotation_type)}, which cannot be read",
            "export again from Motive, with rotations as quaternions or XYZ",
        )
    if not np.isfinite(rotation_numbers).all():
        return np.full(3, np.nan)
    if rotation_type == QUATERNION:
        x, y, z, w = rotation_numbers.tolist()
        if abs(math.hypot(x, y, z, w) - 1) >= 0.01:
            return np.full(3, np.nan)
        return np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])
    angles_deg = [rotation_numbers["XYZ".index(letter)] for letter in rotation_type]
    rotation = Rotation.from_euler(rotation_type, angles_deg, degrees=True)
    return np.asarray(rotation.apply([1.0, 0.0, 0.0]))
