"""What Foxglove, Lichtblick and Rerun draw of a trial: Foxglove's messages, in metres.

Positions go from the spec's unit to metres here and nowhere else. Nothing that is not finite is
drawn: viewers drop a whole message for one NaN.
"""

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from tetractl.core.clock import SECOND
from tetractl.core.colors import robot_colors
from tetractl.core.commands import Note
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup, Shape
from tetractl.log.format.prism import prism

WORLD = "world"
GREY = Color(r=0.45, g=0.45, b=0.45, a=1.0)

_LEVELS = {"info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}
Parts = tuple[Timestamp, Vector3, Quaternion]
_UPRIGHT = Quaternion(w=1.0)  # must be given: without it viewers see a zero quaternion


def frame_of(name: str) -> str:
    """Return the name of a robot's coordinate frame."""
    return f"robot/{name}"


def stamp(unix_ns: int) -> Timestamp:
    """Return Unix ns as a protobuf time stamp."""
    return Timestamp(seconds=unix_ns // SECOND, nanos=unix_ns % SECOND)


def encode_note(note: Note, start_ns: int) -> Log:
    """Encode one line of the /log channel, of a trial that starts at `start_ns` [Unix ns]."""
    unix = stamp(start_ns + note.t_ns)
    return Log(timestamp=unix, level=_LEVELS[note.level], message=note.text, name="tetractl")


def decode_note(message: Log, start_ns: int) -> Note:
    """Decode what `encode_note` encodes; a level that tetractl does not write becomes "info"."""
    unix_ns = message.timestamp.seconds * SECOND + message.timestamp.nanos
    level = next((name for name, value in _LEVELS.items() if value == message.level), "info")
    return Note(unix_ns - start_ns, level, message.message)


class _Refilled:
    """The parts of a repeated field, which are made once and filled anew for each message: making
    one takes longer than all else. `part` returns what is to be filled in of one."""

    def __init__(self, field: Any, part: Callable[[Any], Any]) -> None:
        self._field, self._part = field, part
        self._parts: list[Any] = []

    def first(self, count: int) -> list[Any]:
        """Return so many parts; the field has no others then."""
        del self._field[count:], self._parts[count:]
        while len(self._parts) < count:
            self._parts.append(self._part(self._field.add()))
        return self._parts


class Scene:
    """Draws one experiment; lengths that come in are in its unit."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._metres = setup.metres
        self._frames = [frame_of(name) for name in setup.names]
        self._colors = [_color(text) for text in robot_colors(setup.names, setup.colors)]
        radius, arena = setup.wheel_radius, setup.arena
        body = 2 * radius if radius else 0.03 * min(arena.width, arena.height)
        self._body = body * self._metres
        self._shown: list[bool] | None = None  # which robots the last transforms were of
        self._plan_poses = PosesInFrame(frame_id=WORLD)
        self._poses = _Refilled(
            self._plan_poses.poses, lambda pose: (pose.position, pose.orientation)
        )
        self._plan_lines = SceneUpdate(
            entities=[
                self._entity(
                    f"plan/{name}",
                    0,
                    lines=[self._line(np.empty((0, 2)), color, LinePrimitive.LINE_STRIP)],
                )
                for name, color in zip(setup.names, self._colors, strict=True)
            ]
        )
        self._points = [
            _Refilled(entity.lines[0].points, lambda point: point)
            for entity in self._plan_lines.entities
        ]

    def transforms(self, observation: Observation, unix_ns: int) -> FrameTransforms:
        """Return world to each robot; a robot that is not tracked is left out.

        The message is good until the next call, which fills it anew where all robots are tracked:
        making one takes longer than all else of a camera frame's record.
        """
        poses = observation.poses
        seconds, nanos = divmod(unix_ns, SECOND)
        rows = list(zip(poses.x.tolist(), poses.y.tolist(), poses.heading.tolist(), strict=True))
        shown = [
            valid and math.isfinite(x + y + heading)
            for (x, y, heading), valid in zip(rows, observation.valid.tolist(), strict=True)
        ]
        if shown != self._shown:
            self._shown = shown
            self._message, self._parts = self._blank(shown)
        kept = itertools.compress(rows, shown)
        for (stamped, moved, turned), (x, y, heading) in zip(self._parts, kept, strict=True):
            stamped.seconds, stamped.nanos = seconds, nanos
            moved.x, moved.y = x * self._metres, y * self._metres
            turned.z, turned.w = math.sin(heading / 2), math.cos(heading / 2)
        return self._message

    def _blank(self, shown: list[bool]) -> tuple[FrameTransforms, list[Parts]]:
        """Return transforms of the robots shown, and what is to be filled in for each."""
        message = FrameTransforms()
        for frame in itertools.compress(self._frames, shown):
            message.transforms.add(parent_frame_id=WORLD, child_frame_id=frame)
        return message, [
            (one.timestamp, one.translation, one.rotation) for one in message.transforms
        ]

    def plan_poses(self, path: Floats, unix_ns: int) -> PosesInFrame:
        """Return the predicted poses, (length + 1, N, 3), robot after robot.

        The message is good until the next call, as that of `transforms`.
        """
        message = self._plan_poses
        message.timestamp.CopyFrom(stamp(unix_ns))
        rows = _finite(path.swapaxes(0, 1).reshape(-1, 3))
        for pose, (x, y, heading) in zip(self._poses.first(len(rows)), rows, strict=True):
            pose[0].x, pose[0].y = x * self._metres, y * self._metres
            pose[1].z, pose[1].w = math.sin(heading / 2), math.cos(heading / 2)
        return message

    def plan_lines(self, path: Floats, unix_ns: int) -> SceneUpdate:
        """Return one line a robot along its predicted path; the next one replaces it.

        The message is good until the next call, as that of `transforms`.
        """
        message, at = self._plan_lines, stamp(unix_ns)
        for i, (entity, points) in enumerate(zip(message.entities, self._points, strict=True)):
            entity.timestamp.CopyFrom(at)
            rows = _finite(path[:, i, :2])
            for point, (x, y) in zip(points.first(len(rows)), rows, strict=True):
                point.x, point.y = x * self._metres, y * self._metres
        return message

    def static(self, unix_ns: int) -> SceneUpdate:
        """Return what never changes: arena, obstacles, targets, a body in each robot's frame."""
        arena = self._setup.arena
        corners = [
            (arena.left, arena.bottom),
            (arena.right, arena.bottom),
            (arena.right, arena.top),
            (arena.left, arena.top),
        ]
        border = self._line(np.array(corners), GREY, LinePrimitive.LINE_LOOP)
        entities = [self._entity("arena", unix_ns, lines=[border])]
        for i, obstacle in enumerate(self._setup.obstacles):
            entities.append(self._obstacle(f"obstacle/{i}", unix_ns, obstacle))
        targets = self._setup.targets
        for name, color, target in zip(self._setup.names, self._colors, targets, strict=True):
            entities.append(self._target(name, color, target, unix_ns))
            entities.append(self._robot(name, color, unix_ns))
        return SceneUpdate(entities=entities)

    def _obstacle(self, entity_id: str, unix_ns: int, obstacle: Shape) -> SceneEntity:
        """An upright block over the outline, as high as a robot."""
        corners, triangles = prism(obstacle.outline() * self._metres, self._body)
        block = TriangleListPrimitive(
            pose=Pose(orientation=_UPRIGHT),
            points=[Point3(x=x, y=y, z=z) for x, y, z in corners.tolist()],
            indices=triangles.ravel().tolist(),
            color=GREY,
        )
        return self._entity(entity_id, unix_ns, triangles=[block])

    def _target(self, name: str, color: Color, target: Floats, unix_ns: int) -> SceneEntity:
        """A ring the size of the robot round its target."""
        angle = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
        ring = np.column_stack([np.cos(angle), np.sin(angle)]) * (self._body / 2 / self._metres)
        line = self._line(ring + target, color, LinePrimitive.LINE_LOOP)
        return self._entity(f"target/{name}", unix_ns, lines=[line])

    def _robot(self, name: str, color: Color, unix_ns: int) -> SceneEntity:
        """A wedge that points along the heading, and the robot's name above it."""
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
        """An entity that stays until it is replaced and follows its frame."""
        return SceneEntity(
            timestamp=stamp(unix_ns),
            frame_id=WORLD,
            id=entity_id,
            frame_locked=True,
            **primitives,
        )

    def _line(self, xy: Floats, color: Color, kind: LinePrimitive.Type.ValueType) -> LinePrimitive:
        """A line 2 pixels wide through xy (M, 2)."""
        points = [Point3(x=x * self._metres, y=y * self._metres) for x, y in _finite(xy)]
        return LinePrimitive(
            type=kind,
            pose=Pose(orientation=_UPRIGHT),
            thickness=2.0,
            scale_invariant=True,
            points=points,
            color=color,
        )


def _finite(rows: Floats) -> list[list[float]]:
    """Return the rows (M, K) without a number that is not finite."""
    return rows[np.isfinite(rows).all(axis=1)].tolist()


def _color(text: str) -> Color:
    r, g, b = (int(text[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return Color(r=r, g=g, b=b, a=1.0)
