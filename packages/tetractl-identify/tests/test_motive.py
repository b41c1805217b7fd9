"""Tests of reading Motive's exports as poses: all versions, both vertical axes, both rotations."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from tetractl_identify.motive import read_table_rows

from tetractl.core.errors import UsageError
from tetractl.core.poses import wrap
from tetractl.lab.cameras.optitrack.natnet import RigidBody, UpAxis, planar_pose

TIMES_S = np.arange(40) / 20
UNITS = {"Meters": ("m", 1.0), "Millimeters": ("mm", 1e3), "Centimeters": ("cm", 1e2)}
"""Motive's units of length: in names of columns, and how many are a metre."""


def circle(body):
    """The place (x, y) [m] and heading [rad] of a body on a circle, at TIMES_S, as (M, 3)."""
    angle = (0.4 + 0.3 * body) * TIMES_S + body
    radius = 0.2 + 0.1 * body
    x = radius * np.sin(angle) + 0.5 * body
    return np.column_stack([x, -radius * np.cos(angle), angle])


def of_axes(kind, name, quantity, axes, numbers):
    """A column for each axis."""
    return [(kind, name, quantity, axis, n) for axis, n in zip(axes, numbers, strict=True)]


@dataclass(frozen=True)
class Export:
    """How Motive writes three bodies that drive on circles, on a floor 0.1 m above 0."""

    version: str = "1.23"
    up: str = "y"
    rotation: str = "Quaternion"
    units: str = "Meters"
    markers: bool = True
    labels: tuple[str, ...] = ("Type", "Name", "ID")
    bodies: tuple[str, ...] = ("green", "blue", "red")
    lost: tuple[int, ...] = ()
    """Frames in which the first body is not tracked."""

    def columns(self, body, name):
        """The columns of a body: type, name, quantity, axis, and numbers (M,)."""
        angles = "XYZW" if self.rotation == "Quaternion" else "XYZ"
        _, per_metre = UNITS[self.units]
        place, turned = self.numbers(circle(body))
        place = per_metre * np.array(place)
        columns = [
            *of_axes("Rigid Body", name, "Rotation", angles, turned),
            *of_axes("Rigid Body", name, "Position", "XYZ", place),
            ("Rigid Body", name, "Mean Marker Error", "", 0.0002),
        ]
        if self.markers:
            marker = f"{name}:Marker1"
            columns += of_axes("Rigid Body Marker", marker, "Position", "XYZ", place + 0.03)
            columns.append(("Rigid Body Marker", marker, "Marker Quality", "", 1.0))
            columns += of_axes("Marker", f"{name}:1", "Position", "XYZ", place)
        return columns

    def numbers(self, poses):
        """Positions (3, M) and rotations (4 or 3, M) along Motive's axes."""
        x, y, heading = poses.T
        half = heading / 2
        none = 0 * x
        height = none + 0.1
        if self.up == "y":
            place = (x, height, -y)
            quaternion = (none, np.sin(half), none, np.cos(half))
        else:
            place = (x, y, height)
            quaternion = (none, none, np.sin(half), np.cos(half))
        if self.rotation == "Quaternion":
            return place, quaternion
        degrees = np.degrees(heading)
        if self.up == "z":
            return place, (none, none, degrees)
        # of XYZ, Motive states Y from -90 to 90 degrees, and turns by X and Z for the others
        beyond = np.cos(heading) < 0
        about_y = np.degrees(np.arcsin(np.sin(heading)))
        return place, (180.0 * beyond, about_y, 180.0 * beyond)

    def text(self):
        """The file."""
        columns = [
            column for body, name in enumerate(self.bodies) for column in self.columns(body, name)
        ]
        rows = [list(row) for row in zip(*[column[:4] for column in columns], strict=True)]
        types, names, quantities, axes = rows
        head = [["", label] for label in self.labels] or [["", ""]] * 3
        above = [head[0] + types, head[1] + names, head[2] + ['"9E20"'] * len(names)]
        if "Parent" in self.labels:
            above.append(["", "Parent"] + [""] * len(names))
        above.append(["", "", *quantities])
        above.append(["Frame", "Time (Seconds)", *axes])
        lines = [
            f"Format Version,{self.version},Take Name,drive,Take Notes,,Capture Frame Rate,"
            f"20.000000,Rotation Type,{self.rotation},Length Units,{self.units},"
            "Coordinate Space,Global",
            "",
            *map(",".join, above),
        ]
        for frame, time_s in enumerate(TIMES_S):
            cells = [f"{np.broadcast_to(c[4], TIMES_S.shape)[frame]:.6f}" for c in columns]
            if frame in self.lost:
                cells = [
                    "" if c[1].startswith(self.bodies[0]) else t
                    for c, t in zip(columns, cells, strict=True)
                ]
            lines.append(",".join([str(frame), f"{time_s:.6f}", *cells]))
        return "\n".join(lines) + "\n"


EXPORTS = {
    "1.23, y up": Export(),
    "1.21, without words in front": Export("1.21", labels=()),
    "1.25, with parents": Export("1.25", labels=("Type", "Name", "ID", "Parent")),
    "z up": Export(up="z"),
    "Euler angles, y up": Export(rotation="XYZ"),
    "Euler angles, z up": Export(rotation="XYZ", up="z"),
    "millimetres": Export("1.24", units="Millimeters"),
    "centimetres": Export("1.24", units="Centimeters"),
    "no markers": Export(markers=False),
    "one body": Export(bodies=("green",)),
    "not tracked at times": Export(lost=(3, 4, 5)),
}


def write(folder, text):
    path = folder / "take.csv"
    path.write_text(text, encoding="utf-8")
    return path


def column(rows, name):
    return [float(row.cells[name]) for row in rows]


def poses_of(rows, unit="m"):
    """The places and headings (M, 3) that rows state."""
    places = [column(rows, f"x_{unit}"), column(rows, f"y_{unit}")]
    return np.column_stack([*places, column(rows, "heading_rad")])


def assert_agree(poses, expected):
    assert poses[:, :2] == pytest.approx(expected[:, :2], abs=1e-5)
    assert wrap(poses[:, 2] - expected[:, 2]) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("name", EXPORTS)
def test_what_motive_exports_is_read(tmp_path, name):
    export = EXPORTS[name]
    rows = list(read_table_rows(write(tmp_path, export.text())))
    unit, per_metre = UNITS[export.units]
    for body, robot in enumerate(export.bodies):
        of_body = [row for row in rows if row.cells["robot"] == robot]
        assert column(of_body, "time_s") == pytest.approx(TIMES_S)
        is_lost = np.isin(np.arange(len(TIMES_S)), export.lost if body == 0 else ())
        poses = poses_of(of_body, unit)
        expected = circle(body) * (per_metre, per_metre, 1)
        assert np.isnan(poses[is_lost, 0]).all()
        assert_agree(poses[~is_lost], expected[~is_lost])


@pytest.mark.parametrize("up", ["y", "z"])
def test_poses_are_those_of_the_camera(tmp_path, up):
    """A tilted body: the heading is that of `planar_pose`."""
    rng = np.random.default_rng(4)
    quaternions = rng.normal(0, 1, (30, 4)) * ((0.1, 1, 0.1, 1) if up == "y" else 1)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    places = rng.normal(0, 1, (30, 3)) * ((1, 0.01, 1) if up == "y" else (1, 1, 0.01))
    lines = Export(up=up, bodies=("green",), markers=False).text().splitlines()[:7]
    expected = []
    for frame, (quaternion, place) in enumerate(zip(quaternions, places, strict=True)):
        numbers = ",".join(f"{number:.9f}" for number in (*quaternion, *place))
        lines.append(f"{frame},{frame / 20},{numbers},0")
        body = RigidBody(1, tuple(place), tuple(quaternion), tracking_valid=True)
        pose = planar_pose(body, UpAxis[up.upper()])
        expected.append((pose.x, pose.y, pose.heading))
    rows = list(read_table_rows(write(tmp_path, "\n".join([*lines, ""]))))
    assert_agree(poses_of(rows), np.array(expected))


PLAIN = Export().text()
REFUSED = {
    "feet": (PLAIN.replace("Meters", "Feet"), "Length Units are Feet"),
    "places in another body's frame": (
        PLAIN.replace("Coordinate Space,Global", "Coordinate Space,Local"),
        "Coordinate Space is Local, .* to other bodies",
    ),
    "another rotation": (PLAIN.replace("Quaternion", "Matrix"), "Rotation Type is Matrix"),
    "markers alone": (PLAIN.replace("Rigid Body", "Marker"), "names no rigid body"),
    "no rotations": (PLAIN.replace("Rotation,", "Position,"), "lacks the rotations or positions"),
    "two bodies of one name": (
        Export(bodies=("green", "green")).text(),
        "two rigid bodies have the same name, green",
    ),
    "cut off in the header": ("\n".join(PLAIN.splitlines()[:4]), "no row begins with Frame"),
    "no numbers": ("\n".join(PLAIN.splitlines()[:7]), "has no rows"),
    "a word": (PLAIN.replace("\n3,", "\nthree,"), "line 11: three is not a number"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_refused(tmp_path, name):
    text, says = REFUSED[name]
    with pytest.raises(UsageError, match=says):
        list(read_table_rows(write(tmp_path, text)))


def test_a_coordinate_space_that_is_not_stated_is_global(tmp_path):
    rows = list(read_table_rows(write(tmp_path, PLAIN.replace(",Coordinate Space,Global", ""))))
    assert len(rows) == 3 * len(TIMES_S)


def test_semicolons_of_a_spreadsheet_are_read(tmp_path):
    rows = list(
        read_table_rows(write(tmp_path, replace(Export(), markers=False).text().replace(",", ";")))
    )
    assert len(rows) == 3 * len(TIMES_S)
