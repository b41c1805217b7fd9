"""Tests of the simulated camera: what its frames show, and when the host has them."""

import math

import numpy as np
import pytest

from tetractl.core.clock import NEVER_NS
from tetractl.core.errors import WrongValueError
from tetractl.core.poses import POSE_MAX, Poses
from tetractl.plant.sim_camera import SimCamera
from tetractl.plant.sim_section import MeasurementNoise
from tetractl.spec.disturbance import Disturbance

MS = 1_000_000


def camera(*disturbances, position=0.0, heading=0.0, seed=1):
    noise = MeasurementNoise(position=position, heading=heading)
    return SimCamera(2, noise, disturbances, np.random.default_rng(seed))


def expose(sim_camera, *times_ms, first=0):
    """Expose frames in which all numbers are the time [ms]."""
    times_ns = np.array(times_ms) * MS
    truth = np.broadcast_to(np.array(times_ms, dtype=float)[:, None, None], (len(times_ms), 3, 2))
    sim_camera.expose(times_ns, truth.copy())


class Late(Disturbance):
    """Delays the frame exposed at each of some times [ms], or loses it (None)."""

    def __init__(self, late_ms):
        self.late_ms = late_ms

    def received(self, exposed_ns, received_ns):
        late_ms = self.late_ms.get(exposed_ns // MS, 0)
        return None if late_ms is None else received_ns + late_ms * MS


def test_without_disturbances_frames_arrive_at_once_and_show_the_truth():
    sim_camera = camera()
    assert (sim_camera.newest, sim_camera.next_arrival_ns) == (None, None)
    expose(sim_camera, 0, 10)
    assert sim_camera.newest is None, "it is on its way until the host receives it"
    assert sim_camera.next_arrival_ns == 0
    sim_camera.receive(9 * MS)
    assert sim_camera.newest.frame == 0
    assert sim_camera.next_arrival_ns == 10 * MS
    sim_camera.receive(10 * MS)
    assert (sim_camera.newest.frame, sim_camera.next_arrival_ns) == (1, None)
    samples = sim_camera.take_samples()
    assert [sample.observation.sampled_ns for sample in samples] == [0, 10 * MS]
    assert [sample.observation.received_ns for sample in samples] == [0, 10 * MS]
    assert all(sample.observation.valid.all() for sample in samples)
    assert [sample.truth.x.tolist() for sample in samples] == [[0, 0], [10, 10]]
    assert samples[1].observation.poses.heading.tolist() == [10, 10]
    assert sim_camera.take_samples() == [], "each frame is read once"


def test_noise_has_the_deviations_of_the_spec_and_the_truth_has_none():
    sim_camera = camera(position=2.0, heading=0.1)
    expose(sim_camera, *range(3000))
    sim_camera.receive(NEVER_NS)
    samples = sim_camera.take_samples()
    measured = np.array([sample.observation.poses.array() for sample in samples])
    truth = np.array([sample.truth.array() for sample in samples])
    assert (truth == np.arange(3000)[:, None, None]).all()
    error = measured - truth
    assert error.std(axis=0) == pytest.approx(np.array([[2, 2, 0.1]] * 2), rel=0.05)
    assert np.abs(error.mean(axis=0)) == pytest.approx(0.0, abs=0.15)
    assert np.abs(np.corrcoef(error.reshape(3000, 6).T) - np.eye(6)).max() < 0.08


def test_only_the_noise_that_the_spec_has_is_added():
    sim_camera = camera(heading=0.1)
    expose(sim_camera, 5)
    sim_camera.receive(NEVER_NS)
    poses = sim_camera.newest.poses
    assert (poses.x.tolist(), poses.y.tolist()) == ([5, 5], [5, 5])
    assert poses.heading.tolist() != [5, 5]


def test_a_lost_frame_never_arrives_but_has_a_number():
    sim_camera = camera(Late({20: None}))
    expose(sim_camera, 10, 20, 30)
    sim_camera.receive(NEVER_NS)
    assert [sample.observation.frame for sample in sim_camera.take_samples()] == [0, 2]


def test_a_frame_that_would_overtake_another_arrives_together_with_it():
    sim_camera = camera(Late({10: 50, 20: 5}), Late({20: 5}))
    expose(sim_camera, 10, 20, 70)
    sim_camera.receive(59 * MS)
    assert sim_camera.take_samples() == []
    sim_camera.receive(NEVER_NS)
    arrivals = [sample.observation.received_ns // MS for sample in sim_camera.take_samples()]
    assert arrivals == [60, 60, 70]


def test_the_frame_at_the_start_arrives_at_once_whatever_disturbs_the_camera():
    sim_camera = camera(Late({0: 50, 10: 50}))
    expose(sim_camera, 0, 10)
    sim_camera.receive(0)
    assert sim_camera.newest.frame == 0
    assert sim_camera.next_arrival_ns == 60 * MS
    lossy = camera(Late({0: None}))
    expose(lossy, 0)
    lossy.receive(0)
    assert lossy.newest.frame == 0


@pytest.mark.parametrize("arrival_ns", [10 * MS - 1, -5, math.nan])
def test_a_disturbance_that_lets_a_frame_arrive_before_its_exposure_is_refused(arrival_ns):
    class Early(Disturbance):
        def received(self, exposed_ns, received_ns):
            return arrival_ns

    with pytest.raises(WrongValueError, match="before its exposure"):
        expose(camera(Early()), 10)


class Hides(Disturbance):
    """Loses the first robot at some times [s], and moves what the camera shows of it there."""

    def __init__(self, *times_s, shown=-1.0):
        self.times_s = times_s
        self.shown = shown

    def measured(self, poses, valid, time_s):
        if time_s not in self.times_s:
            return poses, valid
        x = poses.x.copy()
        x[0] = self.shown
        return Poses(x, poses.y, poses.heading), valid & [False, True]


def test_a_lost_robot_keeps_the_pose_of_the_last_frame_that_arrived():
    sim_camera = camera(Hides(0.03, 0.04), Late({20: None}))
    expose(sim_camera, 10, 20, 30)
    expose(sim_camera, 40, 50)
    sim_camera.receive(NEVER_NS)
    frames = [sample.observation for sample in sim_camera.take_samples()]
    shown = [frame.poses.x.tolist() for frame in frames]
    assert shown == [[10, 10], [10, 30], [10, 40], [50, 50]]
    assert [frame.valid.tolist() for frame in frames] == [
        [True, True],
        [False, True],
        [False, True],
        [True, True],
    ]


def test_a_pose_of_a_lost_robot_may_be_anything_that_of_a_tracked_one_may_not():
    sim_camera = camera(Hides(0.02, shown=math.nan))
    expose(sim_camera, 10, 20)

    class Far(Disturbance):
        def __init__(self, far):
            self.far = far

        def measured(self, poses, valid, time_s):
            return Poses(poses.x + self.far, poses.y, poses.heading), valid

    expose(camera(Far(POSE_MAX)), 0)
    for far in (math.nan, math.inf, -math.inf, 1.01 * POSE_MAX, -1.01 * POSE_MAX):
        with pytest.raises(WrongValueError, match="cannot be logged"):
            expose(camera(Far(far)), 0)
