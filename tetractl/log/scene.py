"""What Foxglove, Lichtblick and Rerun draw of a trial: Foxglove's messages, in metres.

Positions go from the spec's unit to metres here and nowhere else. Nothing that is not finite is
drawn: viewers drop a whole message for one NaN.
"""

import math
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
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

from tetractl.model.state import Floats, Observation
from tetractl.spec.experiment import METRES, Circle, Experiment, Rectangle, Robot

WORLD = "world"
GREY = Color(r=0.45, g=0.45, b=0.45, a=1.0)
OKABE_ITO = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of robots that name none; told apart by colour-blind readers."""

_UPRIGHT = Quaternion(w=1.0)  # must be given: without it viewers see a zero quaternion


def frame_of(robot: Robot) -> str:
    """Return the name of a robot's coordinate frame."""
    return f"robot/{robot.name}"


def stamp(unix_ns: int) -> Timestamp:
    """Return Unix ns as a protobuf time stamp."""
    return Timestamp(seconds=unix_ns // 1_000_000_000, nanos=unix_ns % 1_000_000_000)


def note(unix_ns: int, level: Log.Level.ValueType, text: str) -> Log:
    """Return one line of the /log channel."""
    return Log(timestamp=stamp(unix_ns), level=level, message=text, name="tetractl")


class Scene:
    """Draws one experiment; lengths that come in are in its unit."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self._metres = METRES[experiment.units.length]
        self._frames = [frame_of(robot) for robot in experiment.robots]
        self._colors = [_color(robot, i) for i, robot in enumerate(experiment.robots)]
        arena, wheels = experiment.arena, experiment.wheels
        body = 2 * wheels.radius if wheels else 0.03 * min(arena.width, arena.height)
        self._body = body * self._metres

    def transforms(self, observation: Observation, unix_ns: int) -> FrameTransforms:
        """Return world to each robot; a robot that is not tracked is left out."""
        message = FrameTransforms()
        poses = observation.poses
        seconds, nanos = divmod(unix_ns, 1_000_000_000)
        columns = (poses.x.tolist(), poses.y.tolist(), poses.heading.tolist())
        for frame, x, y, heading, valid in zip(
            self._frames, *columns, observation.valid.tolist(), strict=True
        ):
            if not (valid and math.isfinite(x + y + heading)):
                continue
            transform = message.transforms.add()
            transform.timestamp.seconds, transform.timestamp.nanos = seconds, nanos
            transform.parent_frame_id, transform.child_frame_id = WORLD, frame
            transform.translation.x = x * self._metres
            transform.translation.y = y * self._metres
            transform.rotation.z = math.sin(heading / 2)
            transform.rotation.w = math.cos(heading / 2)
        return message

    def plan_poses(self, path: Floats, unix_ns: int) -> PosesInFrame:
        """Return the predicted poses, (length + 1, N, 3), robot after robot."""
        message = PosesInFrame(timestamp=stamp(unix_ns), frame_id=WORLD)
        for x, y, heading in path.swapaxes(0, 1).reshape(-1, 3).tolist():
            if math.isfinite(x + y + heading):
                pose = message.poses.add()
                pose.position.x, pose.position.y = x * self._metres, y * self._metres
                pose.orientation.z = math.sin(heading / 2)
                pose.orientation.w = math.cos(heading / 2)
        return message

    def plan_lines(self, path: Floats, unix_ns: int) -> SceneUpdate:
        """Return one line a robot along its predicted path; the next one replaces it."""
        return SceneUpdate(
            entities=[
                self._entity(
                    f"plan/{robot.name}",
                    unix_ns,
                    lines=[self._line(path[:, i, :2], self._colors[i], LinePrimitive.LINE_STRIP)],
                )
                for i, robot in enumerate(self._experiment.robots)
            ]
        )

    def static(self, unix_ns: int) -> SceneUpdate:
        """Return what never changes: arena, obstacles, targets, a body in each robot's frame."""
        experiment = self._experiment
        arena = experiment.arena
        right, top = arena.left + arena.width, arena.bottom + arena.height
        corners = [
            (arena.left, arena.bottom),
            (right, arena.bottom),
            (right, top),
            (arena.left, top),
        ]
        border = self._line(np.array(corners), GREY, LinePrimitive.LINE_LOOP)
        entities = [self._entity("arena", unix_ns, lines=[border])]
        for i, obstacle in enumerate(experiment.obstacles):
            entities.append(self._obstacle(f"obstacle/{i}", unix_ns, obstacle))
        for robot, color in zip(experiment.robots, self._colors, strict=True):
            entities += [self._target(robot, color, unix_ns), self._robot(robot, color, unix_ns)]
        return SceneUpdate(entities=entities)

    def _obstacle(self, entity_id: str, unix_ns: int, obstacle: Rectangle | Circle) -> SceneEntity:
        metres, height = self._metres, self._body
        if isinstance(obstacle, Rectangle):
            size = Vector3(x=obstacle.width * metres, y=obstacle.height * metres, z=height)
            center = obstacle.left + obstacle.width / 2, obstacle.bottom + obstacle.height / 2
            cube = CubePrimitive(pose=self._pose(*center, height / 2), size=size, color=GREY)
            return self._entity(entity_id, unix_ns, cubes=[cube])
        across = 2 * obstacle.radius * metres
        cylinder = CylinderPrimitive(
            pose=self._pose(*obstacle.center, height / 2),
            size=Vector3(x=across, y=across, z=height),
            bottom_scale=1.0,
            top_scale=1.0,
            color=GREY,
        )
        return self._entity(entity_id, unix_ns, cylinders=[cylinder])

    def _target(self, robot: Robot, color: Color, unix_ns: int) -> SceneEntity:
        """A ring the size of the robot round its target."""
        angle = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
        ring = np.column_stack([np.cos(angle), np.sin(angle)]) * (self._body / 2 / self._metres)
        line = self._line(ring + np.array(robot.target), color, LinePrimitive.LINE_LOOP)
        return self._entity(f"target/{robot.name}", unix_ns, lines=[line])

    def _robot(self, robot: Robot, color: Color, unix_ns: int) -> SceneEntity:
        """A wedge that points along the heading, and the robot's name above it."""
        half = self._body / 2
        nose = [Point3(x=half), Point3(x=-half, y=half), Point3(x=-half, y=-half)]
        wedge = TriangleListPrimitive(pose=Pose(orientation=_UPRIGHT), points=nose, color=color)
        name = TextPrimitive(
            pose=Pose(position=Vector3(z=self._body), orientation=_UPRIGHT),
            billboard=True,
            scale_invariant=True,
            font_size=14.0,
            color=color,
            text=robot.name,
        )
        entity = self._entity(f"robot/{robot.name}", unix_ns, triangles=[wedge], texts=[name])
        entity.frame_id = frame_of(robot)
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

    def _pose(self, x: float, y: float, z_metres: float) -> Pose:
        position = Vector3(x=x * self._metres, y=y * self._metres, z=z_metres)
        return Pose(position=position, orientation=_UPRIGHT)

    def _line(self, xy: Floats, color: Color, kind: LinePrimitive.Type.ValueType) -> LinePrimitive:
        """A line 2 pixels wide through xy (M, 2)."""
        finite = xy[np.isfinite(xy).all(axis=1)] * self._metres
        return LinePrimitive(
            type=kind,
            pose=Pose(orientation=_UPRIGHT),
            thickness=2.0,
            scale_invariant=True,
            points=[Point3(x=x, y=y) for x, y in finite.tolist()],
            color=color,
        )


def _color(robot: Robot, index: int) -> Color:
    name = robot.color or OKABE_ITO[index % len(OKABE_ITO)]
    if not name.startswith("#"):
        from matplotlib import colors  # slow to import, and only named colours need it

        name = colors.to_hex(name) if colors.is_color_like(name) else OKABE_ITO[0]
    r, g, b = (int(name[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return Color(r=r, g=g, b=b, a=1.0)
