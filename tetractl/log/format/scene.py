"""Encode the messages that log viewers draw, in Foxglove's formats and in metres.

Positions are converted from the spec's unit to metres. Non-finite values are not drawn, since
viewers drop a whole message for one NaN.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.colors import GREY, OBSTACLE, robot_colors
from tetractl.core.errors import printable
from tetractl.core.loggable import drawn
from tetractl.core.poses import Floats, Frames
from tetractl.core.setup import Setup
from tetractl.core.trial import Note
from tetractl.log.format.channels import TEXT

WORLD = "world"

_LEVELS = {"debug": Log.DEBUG, "info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}
_STRIP = LinePrimitive.LINE_STRIP
_UPRIGHT = Quaternion(w=1.0)  # must be set: the default is a zero quaternion
_SQUARE = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
_ANGLES = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
_RING = np.column_stack([elementwise.cos(_ANGLES), elementwise.sin(_ANGLES)])


def frame_of(name: str) -> str:
    """Return the name of a robot's coordinate frame, by which viewers place the robot."""
    return f"robot/{name}"


def stamp(unix_ns: int) -> Timestamp:
    """Convert a time [Unix ns] to a protobuf time stamp."""
    return Timestamp(seconds=unix_ns // SECOND, nanos=unix_ns % SECOND)


def encode_note(note: Note, start_ns: int) -> Log:
    """Encode an operator message for the topic /log, cut to TEXT characters.

    `start_ns` is the time at which the trial started [Unix ns].
    """
    unix = stamp(start_ns + note.t_ns)
    text = printable(note.text, TEXT)
    return Log(timestamp=unix, level=_LEVELS[note.level], message=text, name="tetractl")


def decode_note(message: Log, start_ns: int) -> Note:
    """Decode a message of the topic /log, with its time since the trial's start.

    `start_ns` is the time at which the trial started [Unix ns]. A level that tetractl does not
    know becomes "info".
    """
    unix_ns = message.timestamp.seconds * SECOND + message.timestamp.nanos
    level = next((name for name, value in _LEVELS.items() if value == message.level), "info")
    return Note(unix_ns - start_ns, level, message.message)


BODY_OF_ARENA = 0.03
"""Size of a robot without wheels in viewers, as a fraction of the arena's shorter side."""


class Scene:
    """Creates the messages with which a log viewer draws one experiment.

    Lengths are given in the experiment's unit. The numbers of transforms and plans are rounded by
    `drawn`, unless `exact`. A lab's transforms are exact, because they are also a second copy of
    its camera frames.
    """

    def __init__(self, setup: Setup, exact: bool = False) -> None:
        self._setup = setup
        self._rounded = np.asarray if exact else drawn
        self._metres = setup.metres
        self._colors = [_color(text) for text in robot_colors(setup.names, setup.colors)]
        body = BODY_OF_ARENA * min(setup.arena.width, setup.arena.height)
        if setup.wheel_radius:
            body = 2 * setup.wheel_radius
        self._body = body * self._metres

    def transforms(self, parts: Sequence[Frames], start_ns: int) -> list[FrameTransforms]:
        """Return the robots' coordinate frames, as transforms, for each part of camera frames.

        They are ordered by robot. A robot has none for a frame in which it is untracked. The trial
        began at `start_ns` [Unix ns].
        """
        frames = Frames.joined(parts)
        has_pose = frames.valid & np.isfinite(frames.poses).all(axis=2)
        times = [stamp(unix_ns) for unix_ns in (frames.sampled_ns + start_ns).tolist()]
        robots, rows = np.nonzero(has_pose.T)
        x, y, heading = frames.poses[rows, robots].T
        half_turn = heading / 2
        z = elementwise.sin(half_turn)
        w = elementwise.cos(half_turn)
        numbers = (x * self._metres, y * self._metres, z, w)
        poses = self._rounded(np.transpose(numbers)).tolist()
        part_of_row = [index for index, part in enumerate(parts) for _ in part.numbers]
        names = [frame_of(name) for name in self._setup.names]
        transforms = [FrameTransforms() for _ in parts]
        of_poses = zip(robots.tolist(), rows.tolist(), poses, strict=True)
        for robot, row, (x_m, y_m, sine, cosine) in of_poses:
            transforms[part_of_row[row]].transforms.add(
                timestamp=times[row],
                parent_frame_id=WORLD,
                child_frame_id=names[robot],
                translation=Vector3(x=x_m, y=y_m),
                rotation=Quaternion(z=sine, w=cosine),
            )
        return transforms

    def plan(self, path: Floats, unix_ns: int) -> SceneUpdate:
        """Draw a line along each robot's predicted path, shape (length + 1, N, 3).

        It is shown until the next plan. `unix_ns` is the time of the message [Unix ns].
        """
        entities: list[SceneEntity] = []
        places_m = self._rounded(path[..., :2] * self._metres).swapaxes(0, 1)
        for name, color, xy_m in zip(self._setup.names, self._colors, places_m, strict=True):
            line = self._line(xy_m, color)
            entities.append(self._entity(f"plan/{name}", unix_ns, lines=[line]))
        return SceneUpdate(entities=entities)

    def static(self, unix_ns: int) -> SceneUpdate:
        """Draw the parts that do not move: arena, obstacles, targets, and the robots' bodies.

        Each body is drawn in the coordinate frame of its robot.
        """
        arena = self._setup.arena
        corners = [
            (arena.left, arena.bottom),
            (arena.right, arena.bottom),
            (arena.right, arena.top),
            (arena.left, arena.top),
        ]
        border = self._line(np.array(corners) * self._metres, _color(GREY), LinePrimitive.LINE_LOOP)
        entities = [self._entity("arena", unix_ns, lines=[border])]
        for i, obstacle in enumerate(self._setup.obstacles):
            # an upright prism over its outline, as high as a robot
            corners, triangles = prism(obstacle.outline() * self._metres, self._body)
            block = TriangleListPrimitive(
                pose=Pose(orientation=_UPRIGHT),
                points=[Point3(x=x, y=y, z=z) for x, y, z in corners.tolist()],
                indices=triangles.ravel().tolist(),
                color=_color(OBSTACLE),
            )
            entities.append(self._entity(f"obstacle/{i}", unix_ns, triangles=[block]))
        legs = self._setup.legs.swapaxes(0, 1)
        for name, color, points in zip(self._setup.names, self._colors, legs, strict=True):
            entities.append(self._target(name, color, points[:-1], points[-1], unix_ns))
            entities.append(self._robot(name, color, unix_ns))
        return SceneUpdate(entities=entities)

    def _target(
        self, name: str, color: Color, way_points: Floats, target: Floats, unix_ns: int
    ) -> SceneEntity:
        """Draw squares at a robot's target and way-points, and a ring if it has to stay there.

        The square around the target is as wide as a robot, those around way-points half as wide.
        The ring has the hold's radius.
        """
        half = self._body / 2 / self._metres
        outlines = [half * _SQUARE + target]
        outlines += [half / 2 * _SQUARE + point for point in way_points]
        if self._setup.hold is not None:
            outlines.append(self._setup.hold.radius * _RING + target)
        lines = [self._line(xy * self._metres, color, LinePrimitive.LINE_LOOP) for xy in outlines]
        return self._entity(f"target/{name}", unix_ns, lines=lines)

    def _robot(self, name: str, color: Color, unix_ns: int) -> SceneEntity:
        """Draw a robot's body as a wedge that points along its heading, with the name above it."""
        half = self._body / 2
        nose = [Point3(x=half), Point3(x=-half, y=half), Point3(x=-half, y=-half)]
        wedge = TriangleListPrimitive(pose=Pose(orientation=_UPRIGHT), points=nose, color=color)
        label = TextPrimitive(
            pose=Pose(position=Vector3(z=self._body), orientation=_UPRIGHT),
            billboard=True,
            scale_invariant=True,
            font_size=14.0,
            color=color,
            text=name,
        )
        entity = self._entity(f"robot/{name}", unix_ns, triangles=[wedge], texts=[label])
        entity.frame_id = frame_of(name)
        return entity

    def _entity(self, entity_id: str, unix_ns: int, **primitives: Any) -> SceneEntity:
        """Create a drawing that stays until it is replaced, and moves with its coordinate frame."""
        return SceneEntity(
            timestamp=stamp(unix_ns), frame_id=WORLD, id=entity_id, frame_locked=True, **primitives
        )

    def _line(
        self, xy: Floats, color: Color, kind: LinePrimitive.Type.ValueType = _STRIP
    ) -> LinePrimitive:
        """Draw a line, 2 pixels wide, through the points xy (M, 2) [m] that are finite."""
        finite = xy[np.isfinite(xy).all(axis=1)]
        points = [Point3(x=x, y=y) for x, y in finite.tolist()]
        return LinePrimitive(
            type=kind,
            pose=Pose(orientation=_UPRIGHT),
            thickness=2.0,
            scale_invariant=True,
            points=points,
            color=color,
        )


def _color(text: str) -> Color:
    r, g, b = (int(text[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return Color(r=r, g=g, b=b, a=1.0)


def prism(outline: Floats, height: float) -> tuple[Floats, NDArray[np.int64]]:
    """Compute the walls and the top of a prism over an outline (M, 2).

    The result consists of corners (2 M, 3) and triangles (T, 3).

    The outline is simple and anticlockwise; the triangles are anticlockwise seen from outside.
    """
    count = len(outline)
    bottom = np.hstack([outline, np.zeros((count, 1))])
    top = np.hstack([outline, np.full((count, 1), height)])
    corners = np.vstack([bottom, top])
    corner = np.arange(count)
    following = np.roll(corner, -1)
    lower = np.column_stack([corner, following, following + count])
    upper = np.column_stack([corner, following + count, corner + count])
    walls = np.vstack([lower, upper])
    return corners, np.vstack([walls, triangulate(outline) + count])


def triangulate(outline: Floats) -> NDArray[np.int64]:
    """Triangulate a simple anticlockwise polygon (M, 2) by ear clipping, as (M - 2, 3) indices.

    An ear is a corner that turns left and whose triangle contains no other corner.
    """
    corners = list(range(len(outline)))  # those not cut yet
    triangles = []
    while len(corners) > 3:
        before = corners[-1:] + corners[:-1]
        after = corners[1:] + corners[:1]
        at_corners = list(zip(before, corners, after, strict=True))
        ears = (triangle for triangle in at_corners if _is_ear(outline, corners, triangle))
        # rounding may leave no ear among nearly collinear corners: any corner may then be cut
        cut = next(ears, at_corners[0])
        triangles.append(cut)
        corners.remove(cut[1])
    return np.array([*triangles, corners], dtype=np.int64)


def _is_ear(outline: Floats, corners: list[int], triangle: tuple[int, int, int]) -> bool:
    a, b, c = outline[list(triangle)]
    if _turn(a, b, c) <= 0:
        return False
    rest = outline[[corner for corner in corners if corner not in triangle]]
    inside = (_turn(a, b, rest) >= 0) & (_turn(b, c, rest) >= 0) & (_turn(c, a, rest) >= 0)
    return not inside.any()


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Compute twice the signed area of triangles a, b, c (..., 2).

    It is positive if anticlockwise.
    """
    return (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])
