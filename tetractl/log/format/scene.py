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
from tetractl.core.loggable import round_for_drawing
from tetractl.core.poses import Floats, Frames
from tetractl.core.setup import Setup
from tetractl.core.trial import Note
from tetractl.log.format.channels import NOTE_LENGTH_MAX

WORLD = "world"
"""Name of the coordinate frame of the arena."""

_LEVELS = {"debug": Log.DEBUG, "info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}
_STRIP = LinePrimitive.LINE_STRIP
_UPRIGHT = Quaternion(w=1.0)  # must be set: the default is a zero quaternion
_SQUARE = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
_ANGLES = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
_RING = np.column_stack([elementwise.cos(_ANGLES), elementwise.sin(_ANGLES)])


def robot_frame_id(name: str) -> str:
    """Return the name of the coordinate frame in which viewers draw a robot."""
    return f"robot/{name}"


def to_timestamp(unix_ns: int) -> Timestamp:
    """Convert a time [Unix ns] to a protobuf time stamp."""
    return Timestamp(seconds=unix_ns // SECOND, nanos=unix_ns % SECOND)


def encode_note(note: Note, start_ns: int) -> Log:
    """Encode an operator message for the topic /log, cut to TEXT characters.

    Args:
        note: The message.
        start_ns: Time at which the trial started [Unix ns].
    """
    timestamp = to_timestamp(start_ns + note.t_ns)
    message = printable(note.text, NOTE_LENGTH_MAX)
    return Log(timestamp=timestamp, level=_LEVELS[note.level], message=message, name="tetractl")


def decode_note(message: Log, start_ns: int) -> Note:
    """Decode a message of the topic /log, with its time since the trial's start.

    A level that tetractl does not know becomes "info".

    Args:
        message: The message.
        start_ns: Time at which the trial started [Unix ns].
    """
    unix_ns = message.timestamp.seconds * SECOND + message.timestamp.nanos
    level = next((name for name, value in _LEVELS.items() if value == message.level), "info")
    return Note(unix_ns - start_ns, level, message.message)


BODY_FRACTION = 0.03
"""Size of a robot without wheels in viewers, as a fraction of the arena's shorter side."""


class Scene:
    """Creates the messages with which a log viewer draws one experiment.

    Lengths are given in the experiment's unit.

    Args:
        setup: The experiment's arena, robots, targets and obstacles.
        exact: Whether transforms and plans keep all digits. Otherwise, `round_for_drawing` rounds
            them. A lab's transforms are exact, because they are also a second copy of its camera
            frames.
    """

    def __init__(self, setup: Setup, exact: bool = False) -> None:
        self._setup = setup
        self._round_values = np.asarray if exact else round_for_drawing
        self._metres = setup.metres
        self._colors = [
            _parse_color(hex_color) for hex_color in robot_colors(setup.names, setup.colors)
        ]
        body_size = BODY_FRACTION * min(setup.arena.width, setup.arena.height)
        if setup.wheel_radius:
            body_size = 2 * setup.wheel_radius
        self._body_size_m = body_size * self._metres

    def transforms(self, frame_series: Sequence[Frames], start_ns: int) -> list[FrameTransforms]:
        """Convert camera frames to transforms, which place the coordinate frames of the robots.

        A robot has no transform for a camera frame in which it is untracked.

        Args:
            frame_series: Consecutive series of camera frames.
            start_ns: Time at which the trial began [Unix ns].

        Returns:
            One message for each of `frame_series`, whose transforms are ordered by robot.
        """
        frames = Frames.join(frame_series)
        has_pose = frames.valid & np.isfinite(frames.poses).all(axis=2)
        times = [to_timestamp(unix_ns) for unix_ns in (frames.sampled_ns + start_ns).tolist()]
        robots, rows = np.nonzero(has_pose.T)
        x, y, heading = frames.poses[rows, robots].T
        half_turn = heading / 2
        sin_half_turn = elementwise.sin(half_turn)
        cos_half_turn = elementwise.cos(half_turn)
        numbers = (x * self._metres, y * self._metres, sin_half_turn, cos_half_turn)
        poses = self._round_values(np.transpose(numbers)).tolist()
        series_of_row = [index for index, series in enumerate(frame_series) for _ in series.numbers]
        names = [robot_frame_id(name) for name in self._setup.names]
        transforms = [FrameTransforms() for _ in frame_series]
        tracked = zip(robots.tolist(), rows.tolist(), poses, strict=True)
        for robot, row, (x_m, y_m, sine, cosine) in tracked:
            transforms[series_of_row[row]].transforms.add(
                timestamp=times[row],
                parent_frame_id=WORLD,
                child_frame_id=names[robot],
                translation=Vector3(x=x_m, y=y_m),
                rotation=Quaternion(z=sine, w=cosine),
            )
        return transforms

    def plan(self, path: Floats, unix_ns: int) -> SceneUpdate:
        """Draw a line along each robot's predicted path, which is shown until the next plan.

        Args:
            path: Predicted x, y and heading, shape (length + 1, N, 3).
            unix_ns: Time of the message [Unix ns].
        """
        entities: list[SceneEntity] = []
        places_m = self._round_values(path[..., :2] * self._metres).swapaxes(0, 1)
        for name, color, xy_m in zip(self._setup.names, self._colors, places_m, strict=True):
            line = self._make_line(xy_m, color)
            entities.append(self._make_entity(f"plan/{name}", unix_ns, lines=[line]))
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
        border = self._make_line(
            np.array(corners) * self._metres, _parse_color(GREY), LinePrimitive.LINE_LOOP
        )
        entities = [self._make_entity("arena", unix_ns, lines=[border])]
        for i, obstacle in enumerate(self._setup.obstacles):
            # an upright prism over its outline, as high as a robot
            corners, triangles = prism(obstacle.outline() * self._metres, self._body_size_m)
            block = TriangleListPrimitive(
                pose=Pose(orientation=_UPRIGHT),
                points=[Point3(x=x, y=y, z=z) for x, y, z in corners.tolist()],
                indices=triangles.ravel().tolist(),
                color=_parse_color(OBSTACLE),
            )
            entities.append(self._make_entity(f"obstacle/{i}", unix_ns, triangles=[block]))
        legs = self._setup.legs.swapaxes(0, 1)
        for name, color, points in zip(self._setup.names, self._colors, legs, strict=True):
            entities.append(self._draw_target(name, color, points[:-1], points[-1], unix_ns))
            entities.append(self._draw_robot(name, color, unix_ns))
        return SceneUpdate(entities=entities)

    def _draw_target(
        self, name: str, color: Color, way_points: Floats, target: Floats, unix_ns: int
    ) -> SceneEntity:
        """Draw squares at a robot's target and way-points, and a ring if it has to stay there.

        The square around the target is as wide as a robot, those around way-points half as wide.
        The ring has the hold's radius.
        """
        half_width = self._body_size_m / 2 / self._metres
        outlines = [half_width * _SQUARE + target]
        outlines += [half_width / 2 * _SQUARE + point for point in way_points]
        if self._setup.hold is not None:
            outlines.append(self._setup.hold.radius * _RING + target)
        lines = [
            self._make_line(outline * self._metres, color, LinePrimitive.LINE_LOOP)
            for outline in outlines
        ]
        return self._make_entity(f"target/{name}", unix_ns, lines=lines)

    def _draw_robot(self, name: str, color: Color, unix_ns: int) -> SceneEntity:
        """Draw a robot's body as a wedge that points along its heading, with the name above it."""
        half_length = self._body_size_m / 2
        corners = [
            Point3(x=half_length),
            Point3(x=-half_length, y=half_length),
            Point3(x=-half_length, y=-half_length),
        ]
        wedge = TriangleListPrimitive(pose=Pose(orientation=_UPRIGHT), points=corners, color=color)
        label = TextPrimitive(
            pose=Pose(position=Vector3(z=self._body_size_m), orientation=_UPRIGHT),
            billboard=True,
            scale_invariant=True,
            font_size=14.0,
            color=color,
            text=name,
        )
        entity = self._make_entity(f"robot/{name}", unix_ns, triangles=[wedge], texts=[label])
        entity.frame_id = robot_frame_id(name)
        return entity

    def _make_entity(self, entity_id: str, unix_ns: int, **primitives: Any) -> SceneEntity:
        """Create a drawing that stays until it is replaced, and moves with its coordinate frame."""
        return SceneEntity(
            timestamp=to_timestamp(unix_ns),
            frame_id=WORLD,
            id=entity_id,
            frame_locked=True,
            **primitives,
        )

    def _make_line(
        self, xy: Floats, color: Color, line_type: LinePrimitive.Type.ValueType = _STRIP
    ) -> LinePrimitive:
        """Draw a line, 2 pixels wide, through the points xy (M, 2) [m] that are finite."""
        finite = xy[np.isfinite(xy).all(axis=1)]
        points = [Point3(x=x, y=y) for x, y in finite.tolist()]
        return LinePrimitive(
            type=line_type,
            pose=Pose(orientation=_UPRIGHT),
            thickness=2.0,
            scale_invariant=True,
            points=points,
            color=color,
        )


def _parse_color(hex_color: str) -> Color:
    red, green, blue = (int(hex_color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return Color(r=red, g=green, b=blue, a=1.0)


def prism(outline: Floats, height: float) -> tuple[Floats, NDArray[np.int64]]:
    """Compute the walls and the top of a prism.

    Args:
        outline: The base, a simple anticlockwise polygon, shape (M, 2).
        height: Height of the prism.

    Returns:
        The corners, shape (2 M, 3), and the triangles as indices of corners, shape (T, 3). Seen
        from outside, the triangles are anticlockwise.
    """
    count = len(outline)
    bottom = np.hstack([outline, np.zeros((count, 1))])
    top = np.hstack([outline, np.full((count, 1), height)])
    corners = np.vstack([bottom, top])
    indices = np.arange(count)
    following = np.roll(indices, -1)
    lower_triangles = np.column_stack([indices, following, following + count])
    upper_triangles = np.column_stack([indices, following + count, indices + count])
    walls = np.vstack([lower_triangles, upper_triangles])
    return corners, np.vstack([walls, triangulate(outline) + count])


def triangulate(outline: Floats) -> NDArray[np.int64]:
    """Triangulate a simple anticlockwise polygon (M, 2) by ear clipping, as (M - 2, 3) indices.

    An ear is a corner that turns left and whose triangle contains no other corner.
    """
    corners = list(range(len(outline)))  # indices of the corners that are not cut off yet
    triangles = []
    while len(corners) > 3:
        previous_corners = corners[-1:] + corners[:-1]
        next_corners = corners[1:] + corners[:1]
        candidates = list(zip(previous_corners, corners, next_corners, strict=True))
        ears = (triangle for triangle in candidates if _is_ear(outline, corners, triangle))
        # rounding may leave no ear among nearly collinear corners: any corner may then be cut
        ear = next(ears, candidates[0])
        triangles.append(ear)
        corners.remove(ear[1])
    return np.array([*triangles, corners], dtype=np.int64)


def _is_ear(outline: Floats, corners: list[int], triangle: tuple[int, int, int]) -> bool:
    a, b, c = outline[list(triangle)]
    if _twice_area(a, b, c) <= 0:
        return False
    other_corners = outline[[corner for corner in corners if corner not in triangle]]
    is_inside = (
        (_twice_area(a, b, other_corners) >= 0)
        & (_twice_area(b, c, other_corners) >= 0)
        & (_twice_area(c, a, other_corners) >= 0)
    )
    return not is_inside.any()


def _twice_area(a: Floats, b: Floats, c: Floats) -> Floats:
    """Compute twice the signed area of triangles a, b, c (..., 2).

    It is positive if anticlockwise.
    """
    return (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])
