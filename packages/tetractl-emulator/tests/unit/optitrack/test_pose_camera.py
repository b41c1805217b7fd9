"""Tests of when an emulated camera exposes and sends its frames, and what faults change."""

from random import Random
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.emulator.acting import act
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.optitrack.pose_camera import (
    DELAY_MAX_PERIODS,
    DELAYED_FRACTION,
    JITTER_S,
    PoseCamera,
    noise_of_day,
)
from tetractl_emulator.optitrack.tracked_body import Asset, PoseNoise, TrackedBody, View

from tetractl.core.clock import MILLISECOND, SECOND

RATE_HZ = 100.0
LATENCY_S = 0.005
PERIOD_NS = 10 * MILLISECOND
START_NS = 3 * SECOND


class Camera(PoseCamera):
    """A camera above green and blue, which keeps what it exposes and sends."""

    def __init__(self, seed=1, rate=RATE_HZ, latency_s=LATENCY_S):
        self.exposures = []  # the exposure, the number of its frame, and when
        self.announced = []  # the exposures whose frames left or would have left
        self.sent = []  # the frames, and when they left
        timeline = Timeline(lambda when_ns: None, START_NS)
        stage = SimpleNamespace(
            acting=ActingFaults(),
            timeline=timeline,
            options=SimpleNamespace(seed=seed),
            exposed=lambda *numbers: self.exposures.append((*numbers, timeline.now_ns)),
            sent=self.announced.append,
        )
        self.robots = [
            SimpleNamespace(name=name, x=x, y=0.0, heading=0.0)
            for name, x in (("green", 100.0), ("blue", 200.0))
        ]
        exact = PoseNoise(0.0, 0.0, Random(1))
        tracked = [
            TrackedBody(robot, Asset(number, robot.name), exact, stage.acting)
            for robot, number in zip(self.robots, (7, 9), strict=True)
        ]
        super().__init__(stage, tracked, rate, latency_s, View())

    def _shot(self, number, exposed_ns, bodies):
        return SimpleNamespace(number=number, exposed_ns=exposed_ns, bodies=bodies)

    def _stream(self, frame, now_ns):
        self.sent.append((frame, now_ns))

    def run(self, periods):
        """Run for so many periods from the start, and until the last frame has left."""
        self.timeline.run_to(START_NS + periods * PERIOD_NS + 9 * MILLISECOND)

    def numbers(self):
        return [frame.number for frame, _ in self.sent]

    def act(self, name, **fields):
        return act(self.acting, name, **fields)


def begun(**more):
    camera = Camera(**more)
    camera.begin()
    return camera


def x_of(frame):
    """x of each body of a frame [mm], by its number."""
    return {body.id: body.position[0] * 1000 for body in frame.bodies}


def test_exposure_k_is_taken_k_periods_after_the_start_and_numbered_from_one():
    camera = begun()
    camera.run(4)
    expected = [(k + 1, k + 1, START_NS + k * PERIOD_NS) for k in range(5)]
    assert camera.exposures == expected
    assert camera.announced == [1, 2, 3, 4, 5]
    assert camera.numbers() == [1, 2, 3, 4, 5]
    assert [f.exposed_ns for f, _ in camera.sent] == [at_ns for *_, at_ns in expected]


def test_a_rate_that_does_not_divide_a_second_does_not_drift():
    camera = begun(rate=120.0)
    camera.timeline.run_to(START_NS + 10 * SECOND)
    assert len(camera.exposures) == 1201
    assert camera.exposures[-1][2] == START_NS + 10 * SECOND


def test_a_camera_without_numbers_says_none():
    camera = begun()
    camera.numbered = False
    camera.run(2)
    assert [frame for _, frame, _ in camera.exposures] == [0, 0, 0]


def delays_ms(camera):
    return np.array([(at_ns - f.exposed_ns) / MILLISECOND for f, at_ns in camera.sent])


def test_frames_leave_after_the_latency_with_a_little_jitter_and_a_few_later():
    camera = begun(seed=41007)
    camera.run(4000)
    delays = delays_ms(camera)
    jitter_ms = JITTER_S * 1000
    usual = delays < 5 + 4 * jitter_ms + 1e-6
    assert delays.min() >= 5 - 4 * jitter_ms - 1e-6
    assert delays[usual].mean() == pytest.approx(5, abs=0.02)
    assert delays[usual].std() == pytest.approx(jitter_ms, rel=0.05)
    assert 0.3 * DELAYED_FRACTION < (~usual).mean() < 1.3 * DELAYED_FRACTION
    assert 6.5 < delays.max() < 5 + 4 * jitter_ms + 10 * DELAY_MAX_PERIODS


def test_faults_add_their_delays_and_random_ones_let_frames_overtake():
    camera = begun()
    camera.act("late_frames", by=0.2)
    camera.act("late_frames", by=0.1)
    camera.run(200)
    assert delays_ms(camera).min() > 303
    assert delays_ms(camera).max() < 311
    shuffled = begun()
    shuffled.act("reordered", by=0.05)
    shuffled.run(200)
    delays = delays_ms(shuffled)
    assert delays.min() < 9
    assert 45 < delays.max() < 61
    assert sorted(shuffled.numbers()) != shuffled.numbers()


def test_each_frame_is_sent_twice_by_a_camera_that_doubles_frames():
    camera = begun()
    camera.act("doubled_frames")
    camera.act("doubled_frames")
    camera.run(2)
    assert camera.numbers() == [1, 1, 2, 2, 3, 3]


@pytest.mark.parametrize("fault", ["no_server", "no_frames"])
def test_a_silent_camera_sends_no_frame_though_it_exposes(fault):
    camera = begun()
    camera.run(1)
    before_ns = list(camera.shown_ns)
    silent = camera.act(fault)
    camera.run(5)
    assert camera.numbers() == [1, 2]
    assert camera.announced == [1, 2, 3, 4, 5, 6]
    assert camera.shown_ns == before_ns
    camera.acting.remove(silent)
    camera.run(6)
    assert camera.numbers() == [1, 2, 7]


def test_a_slow_camera_sends_frames_no_faster_than_its_slowest_rate():
    camera = begun()
    fault = camera.act("slow_frames", rate=25.0)
    camera.act("slow_frames", rate=50.0)
    camera.run(12)
    assert camera.numbers() == [1, 5, 9, 13]
    camera.acting.remove(fault)
    camera.run(16)
    assert camera.numbers() == [1, 5, 9, 13, 15, 17]


def test_a_frozen_camera_repeats_the_frame_before_with_its_number():
    camera = begun()
    camera.run(1)
    camera.robots[0].x = 150.0
    frozen = camera.act("freeze")
    camera.run(4)
    assert camera.numbers() == [1, 2, 2, 2, 2]
    assert x_of(camera.sent[-1][0])[7] == pytest.approx(100.0)
    assert camera.shown_ns == [START_NS + PERIOD_NS] * 2
    camera.acting.remove(frozen)
    camera.run(5)
    assert camera.numbers()[-1] == 6
    assert x_of(camera.sent[-1][0])[7] == pytest.approx(150.0)


def test_a_camera_that_is_frozen_from_the_start_repeats_its_first_frame():
    camera = Camera()
    camera.act("freeze")
    camera.begin()
    camera.run(3)
    assert camera.numbers() == [1, 1, 1, 1]


def test_a_counter_goes_back_by_all_faults_and_exposures_go_on():
    camera = begun()
    camera.run(9)
    camera.act("counter_back", frames=4)
    camera.act("counter_back", frames=3)
    camera.run(11)
    assert camera.numbers()[9:] == [10, 4, 5]
    assert [(exposure, frame) for exposure, frame, _ in camera.exposures[-2:]] == [(11, 4), (12, 5)]
    assert camera.announced[-1] == 12


def test_an_outdated_frame_states_an_earlier_exposure_but_none_before_the_clock():
    camera = begun()
    camera.act("outdated", by=0.5)
    camera.run(0)
    assert camera.sent[0][0].exposed_ns == START_NS - SECOND // 2
    camera.act("outdated", by=1000.0)
    camera.run(1)
    assert camera.sent[1][0].exposed_ns == 0
    assert camera.shown_ns == [START_NS + PERIOD_NS] * 2  # as it truly was


def test_a_robot_was_last_shown_by_the_newest_frame_that_tracks_it_with_a_pose():
    camera = begun()
    camera.run(0)
    assert camera.shown_ns == [START_NS] * 2
    hidden = camera.act("untracked", robot="green")
    camera.run(2)
    assert camera.shown_ns == [START_NS, START_NS + 2 * PERIOD_NS]
    camera.acting.remove(hidden)
    camera.act("nan", robot="blue")
    camera.run(3)
    assert camera.shown_ns == [START_NS + 3 * PERIOD_NS, START_NS + 2 * PERIOD_NS]


def test_a_frame_that_was_overtaken_does_not_make_robots_shown_earlier():
    camera = begun()
    late = camera.act("late_frames", by=0.05)
    camera.run(0)
    camera.acting.remove(late)
    camera.timeline.run_to(START_NS + SECOND)
    newest_ns = [frame.exposed_ns for frame, _ in camera.sent]
    assert newest_ns != sorted(newest_ns)
    assert camera.shown_ns == [max(newest_ns)] * 2


def test_a_body_with_its_twins_number_comes_beside_the_twin():
    camera = begun()
    camera.act("twin_id", robot="green", other="blue")
    camera.run(0)
    assert sorted((b.id, round(b.position[0], 3)) for b in camera.sent[0][0].bodies) == [
        (9, 0.1),
        (9, 0.2),
    ]


def test_swapped_bodies_have_each_others_poses_and_their_own_numbers():
    camera = begun()
    camera.act("swap", robot="green", other="blue")
    camera.run(0)
    assert x_of(camera.sent[0][0]) == pytest.approx({7: 200.0, 9: 100.0})


def test_a_body_that_is_not_streamed_is_in_no_frame():
    camera = begun()
    camera.tracked[1].asset.is_streamed = False
    camera.run(1)
    assert [x_of(frame).keys() for frame, _ in camera.sent] == [{7}, {7}]
    assert camera.shown_ns[1] == 0


def test_a_changed_picture_moves_the_bodies_while_it_lasts():
    camera = begun()
    fault = camera.act("picture", by=(10.0, 0.0), scale=1.0, turn=0.0, creeps=False)
    camera.run(0)
    camera.acting.remove(fault)
    camera.run(1)
    assert [x_of(frame)[7] for frame, _ in camera.sent] == pytest.approx([110.0, 100.0])


def test_noise_of_a_day_is_within_its_ranges_and_scaled_as_lengths_are():
    days = [noise_of_day(Random(seed), 1.0) for seed in range(300)]
    for key, low, high in (
        ("noise_mm", 0.1, 0.5),
        ("noise_rad", 0.001, 0.005),
        ("latency", 0.003, 0.012),
    ):
        values = [day[key] for day in days]
        assert low <= min(values) < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < max(values) <= high
    tiny = noise_of_day(Random(3), 0.001)
    assert tiny["noise_mm"] == pytest.approx(days[3]["noise_mm"] / 1000, rel=0.01)
    assert tiny["noise_rad"] == days[3]["noise_rad"]
