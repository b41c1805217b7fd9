"""Tests of what viewers draw: Foxglove's messages, decoded with the schemas in the file."""

import math
from collections import defaultdict

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from testkit import trials
from testkit.random_trials import experiment, trial, write

from tetractl.core import elementwise
from tetractl.core.loggable import DRAWING_PRECISION
from tetractl.core.poses import Frames
from tetractl.core.trial import SIMULATED_START_NS, Note
from tetractl.log.format.scene import Scene, decode_note, encode_note, robot_frame_id, to_timestamp


@pytest.fixture(scope="module")
def random_trial():
    return trial(steps=3, robots=3)


@pytest.fixture(scope="module")
def messages(random_trial, tmp_path_factory):
    """Messages by topic, through the official indexed reader with CRC validation."""
    path = write(random_trial, tmp_path_factory.mktemp("log") / "trial.mcap")
    by_topic = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            by_topic[channel.topic].append(message)
    return by_topic


def corners_of(entity):
    return np.array([(point.x, point.y, point.z) for point in entity.triangles[0].points])


def test_transforms_are_the_measured_poses_in_metres_at_their_times(random_trial, messages):
    """Of 120 Hz every eighth frame is shown; the newest of each message is."""
    (message,) = messages["/tf"]
    transforms = sorted(message.transforms, key=lambda item: (_stamp(item), item.child_frame_id))
    frames = [transforms[first : first + 3] for first in range(0, len(transforms), 3)]
    for sample, of_frame in zip(random_trial.samples[1::8], frames, strict=True):
        poses = sample.observation.poses
        names = [item.child_frame_id for item in of_frame]
        assert names == ["robot/robot 0", "robot/robot 1", "robot/robot 2"]
        for i, item in enumerate(of_frame):
            assert item.parent_frame_id == "world"
            assert item.translation.x == pytest.approx(poses.x[i] / 1000, rel=DRAWING_PRECISION)
            assert item.translation.y == pytest.approx(poses.y[i] / 1000, rel=DRAWING_PRECISION)
            q = item.rotation
            assert q.x**2 + q.y**2 + q.z**2 + q.w**2 == pytest.approx(1, rel=2 * DRAWING_PRECISION)
            yaw = 2 * math.atan2(q.z, q.w)
            assert math.cos(yaw - poses.heading[i]) == pytest.approx(1)
            assert _stamp(item) == SIMULATED_START_NS + sample.observation.sampled_ns


def _stamp(item):
    return item.timestamp.seconds * 10**9 + item.timestamp.nanos


@pytest.fixture(scope="module")
def entities(messages):
    """What stands in the scene, by name: the spec's arena, obstacles, robots and targets."""
    (scene,) = messages["/scene/static"]
    entities = {item.id: item for item in scene.entities}
    assert len(entities) == len(scene.entities) == 1 + 2 + 2 * 3
    return entities


def test_arena_and_obstacles_stand_where_the_spec_says(entities):
    """In metres; the spec is in millimetres."""
    corners = [(point.x, point.y) for point in entities["arena"].lines[0].points]
    assert np.allclose(corners, [(0.6, 0.35), (2.2, 0.35), (2.2, 2.15), (0.6, 2.15)])
    box = corners_of(entities["obstacle/0"])
    assert box.min(axis=0) == pytest.approx((1.2, 1.1, 0))
    assert box.max(axis=0)[:2] == pytest.approx((1.4, 1.3))
    disc = corners_of(entities["obstacle/1"])
    assert np.hypot(*(disc[:, :2] - (0.7, 1.9)).T) == pytest.approx(0.0505)
    assert {z > 0 for z in disc[:, 2]} == {True, False}


NUMBERS = st.floats(width=64) | st.sampled_from([0.0, -0.0, math.pi, 5e-324, 1e308])
UNIX_NS = st.integers(0, 2**62) | st.sampled_from(
    [0, 1, 2**21, SIMULATED_START_NS, SIMULATED_START_NS + 2**28]
)


@pytest.mark.long
@settings(deadline=None)
@given(data=st.data(), robots=st.integers(1, 3), count=st.integers(0, 12))
def test_what_is_tracked_and_finite_is_drawn_of_any_poses_at_any_times(data, robots, count):
    """Zeros, NaN, numbers near the greatest and the least."""
    setup = experiment(robots).setup
    scene = Scene(setup, exact=True)
    colors = {e.id: e.lines[0].color for e in scene.static(0).entities if e.lines}
    poses = data.draw(arrays(float, (count, robots, 3), elements=NUMBERS))
    valid = data.draw(arrays(bool, (count, robots)))
    times = data.draw(arrays(np.int64, count, elements=UNIX_NS))
    unix_ns = data.draw(UNIX_NS)
    transforms = FrameTransforms()
    plans = SceneUpdate()
    for i, name in enumerate(setup.names):
        tracked = valid[:, i] & np.isfinite(poses[:, i]).all(axis=1)
        x, y, heading = poses[tracked, i].T
        x_m = x * setup.metres
        y_m = y * setup.metres
        sine = elementwise.sin(heading / 2)
        cosine = elementwise.cos(heading / 2)
        for row, time_ns in enumerate(times[tracked].tolist()):
            transforms.transforms.add(
                timestamp=to_timestamp(time_ns),
                parent_frame_id="world",
                child_frame_id=robot_frame_id(name),
                translation=Vector3(x=x_m[row], y=y_m[row]),
                rotation=Quaternion(z=sine[row], w=cosine[row]),
            )
        xy = poses[np.isfinite(poses[:, i, :2]).all(axis=1), i, :2] * setup.metres
        line = LinePrimitive(
            pose=Pose(orientation=Quaternion(w=1)),
            thickness=2,
            scale_invariant=True,
            points=[Point3(x=x, y=y) for x, y in xy.tolist()],
            color=colors[f"target/{name}"],
        )
        entity = {"frame_id": "world", "id": f"plan/{name}", "frame_locked": True}
        plans.entities.add(timestamp=to_timestamp(unix_ns), lines=[line], **entity)
    exposed_ns = times[:, None].repeat(robots, axis=1)
    frames = Frames(times, times, times, poses, valid, None, exposed_ns)
    (drawn,) = scene.transforms([frames], 0)
    assert drawn.SerializeToString() == transforms.SerializeToString()
    drawn_plans = scene.plan(poses, unix_ns)
    assert drawn_plans.SerializeToString() == plans.SerializeToString()


def test_a_target_is_a_square_as_in_every_view(entities):
    corners = np.array([(p.x, p.y) for p in entities["target/robot 1"].lines[0].points])
    assert len(corners) == 4
    assert np.allclose(corners.mean(axis=0), (1.7, 0.5997))
    width, height = np.ptp(corners, axis=0)
    assert width == pytest.approx(height)


def test_a_robot_is_drawn_in_a_frame_of_its_own(entities):
    body = entities["robot/robot 2"]
    assert body.frame_id == "robot/robot 2"
    assert body.triangles[0].points[0].x > 0  # the nose points along the heading
    assert body.texts[0].text == "robot 2"


def rgb_of(entity):
    color = entity.triangles[0].color
    return [round(255 * part) for part in (color.r, color.g, color.b)]


def test_colors_are_the_specs_or_the_lists(entities):
    assert rgb_of(entities["robot/robot 0"]) == [0x00, 0x9E, 0x73]  # the spec's "green"
    assert rgb_of(entities["robot/robot 1"]) == [0x00, 0x72, 0xB2]  # the spec's "#0072b2"
    assert rgb_of(entities["robot/robot 2"]) == [0xD5, 0x5E, 0x00]  # the list's, the spec has none


@pytest.mark.parametrize(("unit", "metres"), [("um", 1e-6), ("mm", 1e-3), ("cm", 1e-2), ("m", 1)])
def test_every_unit_comes_to_metres(unit, metres):
    scene = Scene(experiment(1, units={"length": unit}).setup).static(SIMULATED_START_NS)
    box = corners_of(next(item for item in scene.entities if item.id == "obstacle/0"))
    assert np.ptp(box[:, 0]) == pytest.approx(200 * metres)


# ---- Sizes ----


def scene_of(**fields):
    """What stands in the scene of one robot, by name, with its points in mm."""
    scene = Scene(trials.experiment(**fields).setup).static(SIMULATED_START_NS)
    return {entity.id: entity for entity in scene.entities}


def outlines_of(entity):
    return [1000 * np.array([(p.x, p.y) for p in line.points]) for line in entity.lines]


ROBOT = {"name": "green", "start": [900, 800], "target": [1700, 500], "a": 6, "speed": 180}


@pytest.mark.parametrize(
    ("fields", "width_mm"),
    [
        ({"wheels": {"radius": 40}}, 80.0),
        ({}, 0.03 * 1600),  # of the arena's shorter side
        ({"arena": {"left": 0, "bottom": 0, "width": 3000, "height": 2500}}, 0.03 * 2500),
    ],
)
def test_a_robot_and_the_square_at_its_target_are_as_wide_as_its_wheels_are_apart(fields, width_mm):
    entities = scene_of(robots=[ROBOT], **fields)
    (square,) = outlines_of(entities["target/green"])
    assert square.min(axis=0) == pytest.approx([1700 - width_mm / 2, 500 - width_mm / 2])
    assert square.max(axis=0) == pytest.approx([1700 + width_mm / 2, 500 + width_mm / 2])
    nose, left, right = 1000 * corners_of(entities["robot/green"])
    assert nose == pytest.approx([width_mm / 2, 0, 0])
    assert left == pytest.approx([-width_mm / 2, width_mm / 2, 0])
    assert right == pytest.approx([-width_mm / 2, -width_mm / 2, 0])
    label = entities["robot/green"].texts[0]
    assert 1000 * label.pose.position.z == pytest.approx(width_mm)
    assert 1000 * corners_of(entities["obstacle/0"])[:, 2].max() == pytest.approx(width_mm)


def test_way_points_are_squares_half_as_wide_in_their_order():
    entities = scene_of(robots=[ROBOT | {"via": [[1000, 700], [1300, 600]]}], wheels={"radius": 40})
    target, first, second = outlines_of(entities["target/green"])
    assert np.ptp(target, axis=0) == pytest.approx([80, 80])
    for outline, middle in ((first, (1000, 700)), (second, (1300, 600))):
        assert np.ptp(outline, axis=0) == pytest.approx([40, 40])
        assert outline.mean(axis=0) == pytest.approx(middle)


def test_a_robot_that_has_to_stay_has_a_ring_of_the_holds_radius_around_its_target():
    entities = scene_of(robots=[ROBOT], hold={"time": 8, "radius": 33})
    _, ring = outlines_of(entities["target/green"])
    assert np.hypot(*(ring - (1700, 500)).T) == pytest.approx(33)
    assert np.ptp(np.degrees(np.arctan2(*(ring - (1700, 500)).T[::-1]))) > 340


# ---- Times, notes and what is not tracked ----

TIMES_NS = st.integers(0, 2**62)


@given(st.integers(0, 2**60), TIMES_NS, st.sampled_from(["debug", "info", "warning", "error"]))
def test_a_note_is_read_as_it_was_written(t_ns, start_ns, level):
    note = Note(t_ns, level, "green is lost")
    message = encode_note(note, start_ns)
    assert _stamp(message) == start_ns + t_ns
    assert decode_note(message, start_ns) == note


def test_a_level_that_tetractl_does_not_write_is_read_as_info():
    message = encode_note(Note(1, "error", "x"), 0)
    message.level = Log.FATAL
    assert decode_note(message, 0).level == "info"


@given(TIMES_NS)
def test_a_stamp_is_whole_seconds_and_the_nanoseconds_left(unix_ns):
    assert (to_timestamp(unix_ns).seconds, to_timestamp(unix_ns).nanos) == divmod(unix_ns, 10**9)


def test_each_part_of_frames_has_the_transforms_of_its_own_rows_at_their_times():
    setup = experiment(2).setup
    poses = np.arange(18.0).reshape(3, 2, 3)
    valid = np.array([[True, True], [False, True], [True, True]])
    times = np.array([10, 20, 30])
    exposed = times[:, None].repeat(2, axis=1)
    parts = [
        Frames(times[s], times[s], times[s], poses[s], valid[s], None, exposed[s])
        for s in (slice(0, 1), slice(1, 3))
    ]
    drawn = Scene(setup, exact=True).transforms(parts, 1000)
    names = [robot_frame_id(name) for name in setup.names]
    seen = [
        [(item.child_frame_id, _stamp(item), item.translation.x) for item in part.transforms]
        for part in drawn
    ]
    x = poses[..., 0] * setup.metres
    first = [(names[0], 1010, x[0, 0]), (names[1], 1010, x[0, 1])]
    second = [(names[0], 1030, x[2, 0]), (names[1], 1020, x[1, 1]), (names[1], 1030, x[2, 1])]
    assert seen == [first, second]
