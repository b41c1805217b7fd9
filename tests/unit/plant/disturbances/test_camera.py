"""Tests of the disturbances of the camera: what frames show, when they arrive, which are lost."""

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.poses import Poses
from tetractl.plant.disturbances import camera

SETUP = experiment().setup
ROBOTS = len(SETUP.names)
ALL = np.ones(ROBOTS, dtype=bool)


def build(kind, seed=1, **fields):
    section = {
        "tracking-loss": camera.TrackingLossSection,
        "camera-latency": camera.CameraLatencySection,
        "frame-loss": camera.FrameLossSection,
        "frozen-camera": camera.FrozenCameraSection,
        "marker-off": camera.MarkerOffSection,
        "stale-camera": camera.StaleCameraSection,
    }[kind].model_validate({"type": kind} | fields)
    return section, section.build(SETUP, np.random.default_rng(seed))


def poses_at(time_s):
    """Poses from which the time can be read."""
    return Poses(*np.full((3, ROBOTS), float(time_s)))


def shown(disturbance, times_s):
    """The times whose poses the frames at these times show."""
    return [disturbance.measured(poses_at(at), ALL, at)[0].x[0] for at in times_s]


@pytest.mark.parametrize(
    ("kind", "fields", "loses"),
    [
        ("frame-loss", {"share": 0.0}, False),
        ("frame-loss", {"share": 0.1}, True),
        ("frozen-camera", {"duration": 1.0}, False),
        ("frozen-camera", {"duration": 1.0, "repeats": False}, True),
        ("stale-camera", {"duration": 1.0}, False),
        ("camera-latency", {"mean": 0.1}, False),
    ],
)
def test_a_section_knows_whether_it_loses_frames(kind, fields, loses):
    assert build(kind, **fields)[0].loses_frames is loses


def test_a_frozen_camera_shows_the_last_poses_before_the_interval_and_new_ones_after_it():
    _, frozen = build("frozen-camera", between=[1.0, 1.0], duration=0.5)
    times_s = [0.5, 0.9, 1.0, 1.2, 1.49, 1.5, 1.6]
    assert shown(frozen, times_s) == [0.5, 0.9, 0.9, 0.9, 0.9, 1.5, 1.6]
    assert frozen.received(SECOND, 7) == 7, "its frames arrive"


def test_a_camera_that_is_frozen_from_the_start_shows_its_first_poses():
    _, frozen = build("frozen-camera", between=[0.0, 0.0], duration=0.5)
    assert shown(frozen, [0.0, 0.1, 0.49, 0.5]) == [0.0, 0.0, 0.0, 0.5]


def test_a_camera_that_does_not_repeat_loses_the_frames_of_the_interval():
    _, frozen = build("frozen-camera", between=[1.0, 1.0], duration=0.5, repeats=False)
    at_ns = [SECOND - 1, SECOND, 3 * SECOND // 2 - 1, 3 * SECOND // 2]
    arrivals = [frozen.received(exposed_ns, exposed_ns + 5) for exposed_ns in at_ns]
    assert arrivals == [SECOND + 4, None, None, 3 * SECOND // 2 + 5]
    assert shown(frozen, [0.9, 1.2]) == [0.9, 1.2], "the frames that come show no old poses"


def test_a_stale_camera_shows_the_newest_poses_that_are_at_least_so_old():
    _, stale = build("stale-camera", between=[1.0, 1.0], duration=0.5, age=0.25)
    times_s = [k / 8 for k in range(16)]
    expected = [at - 0.25 if 1.0 <= at < 1.5 else at for at in times_s]
    assert shown(stale, times_s) == expected
    _, uneven = build("stale-camera", between=[1.0, 1.0], duration=0.5, age=0.3)
    assert shown(uneven, [0.5, 0.75, 1.0, 1.25]) == [0.5, 0.75, 0.5, 0.75]


def test_a_stale_camera_shows_the_first_poses_before_they_are_so_old():
    _, stale = build("stale-camera", between=[0.0, 0.0], duration=5.0, age=1.0)
    assert shown(stale, [0.0, 0.5, 1.0, 1.5, 2.25]) == [0.0, 0.0, 0.0, 0.5, 1.0]


def test_a_marker_is_off_by_the_same_angle_in_every_frame():
    poses = Poses(*np.arange(3.0 * ROBOTS).reshape(3, ROBOTS))
    signs = []
    for seed in range(200):
        _, marker = build("marker-off", seed, heading=0.2)
        measured, valid = marker.measured(poses, ALL, 0.0)
        assert np.array_equal(measured.xy, poses.xy) and valid is ALL
        offsets = measured.heading - poses.heading
        assert np.abs(offsets) == pytest.approx(0.2)
        assert marker.measured(poses, ALL, 5.0)[0].heading == pytest.approx(measured.heading)
        signs.append(np.sign(offsets))
    assert np.abs(np.mean(signs, axis=0)).max() < 0.3


def test_lost_robots_stay_lost_and_poses_are_not_touched():
    _, loss = build("tracking-loss", every=0.2, duration=0.1)
    nobody = np.zeros(ROBOTS, dtype=bool)
    poses = poses_at(0.0)
    for k in range(40):
        measured, valid = loss.measured(poses, nobody, k / 10)
        assert measured is poses and not valid.any()


def test_a_robot_is_tracked_for_as_long_as_the_spec_says():
    _, loss = build("tracking-loss", seed=5, every=0.3, duration=0.1)
    tracked = np.array([loss.measured(poses_at(0), ALL, k / 100)[1] for k in range(40_000)])
    assert tracked[0].all()
    assert tracked.mean(axis=0) == pytest.approx([0.75] * ROBOTS, abs=0.03)
    losses = (np.diff(tracked.astype(int), axis=0) == -1).sum(axis=0)
    assert losses == pytest.approx([1000] * ROBOTS, rel=0.15)


def test_no_frame_is_lost_before_the_first_and_none_at_all_without_a_share():
    _, never = build("frame-loss", share=0.0)
    assert [never.received(k, k + 3) for k in range(500)] == [k + 3 for k in range(500)]
    for seed in range(50):
        _, often = build("frame-loss", seed, share=0.5)
        assert often.received(0, 3) == 3


@pytest.mark.parametrize(("share", "burst"), [(0.1, 1.0), (0.4, 1.0), (0.2, 5.0)])
def test_frames_are_lost_in_bursts_of_the_mean_length(share, burst):
    _, loss = build("frame-loss", seed=3, share=share, burst=burst)
    lost = np.array([loss.received(k, k) is None for k in range(30_000)])
    bursts = (np.diff(lost.astype(int)) == 1).sum()
    assert lost.mean() == pytest.approx(share, rel=0.1)
    assert lost.sum() / bursts == pytest.approx(burst, rel=0.1)


def test_latency_is_added_to_the_delays_before_it_and_stays_near_its_mean():
    _, late = build("camera-latency", seed=2, mean=0.02, deviation=0.01)
    arrivals_s = np.array([(late.received(0, SECOND) - SECOND) / SECOND for _ in range(4000)])
    assert arrivals_s.min() >= 0
    assert arrivals_s.max() <= 0.02 + 4 * 0.01
    assert np.median(arrivals_s) == pytest.approx(0.02, abs=0.001)
    _, exact = build("camera-latency", mean=0.25)
    assert exact.received(SECOND, 2 * SECOND) == 2.25 * SECOND


def test_latency_varies_by_its_deviation_but_never_further_than_four_of_them():
    _, late = build("camera-latency", seed=2, mean=1.0, deviation=0.1)
    latency_s = np.array([late.received(0, 0) / SECOND for _ in range(20_000)])
    assert latency_s.std() == pytest.approx(0.1, rel=0.05)
    assert np.abs(latency_s - 1.0).max() <= 0.4 + 1e-9

    class Extreme:
        def standard_normal(self):
            return -7.0

        def random(self):
            return 0.5

    section = camera.CameraLatencySection.model_validate(
        {"type": "camera-latency", "mean": 1.0, "deviation": 0.1}
    )
    extreme = camera.CameraLatency(section, Extreme())
    assert extreme.received(0, 0) == pytest.approx(0.6 * SECOND)


def test_late_frames_are_as_many_and_as_late_as_the_spec_says():
    _, late = build("camera-latency", seed=4, mean=0.01, late_share=0.2, late_by=0.5)
    more_s = np.array([late.received(0, 0) / SECOND for _ in range(5000)]) - 0.01
    is_late = more_s > 1e-6
    assert is_late.mean() == pytest.approx(0.2, abs=0.02)
    assert more_s[is_late].mean() == pytest.approx(0.25, abs=0.02)
    assert more_s.max() == pytest.approx(0.5, abs=0.01)
    assert more_s.min() == pytest.approx(0.0, abs=1e-9)
