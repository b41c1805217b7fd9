"""Tests of filters through many frames: symmetries, several robots, frames that are old, starts."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from testkit import filters
from testkit.filters import CASES, NOISE, SPEED, STANDS, STUCK, A, expected_pose, some_covariance

from tetractl.control.estimation.kernels.filter import (
    BLOCK_FRAMES,
    LOST_TRACK_S,
    MOST_SQUARE,
    SCALE_LEAST,
    SCALE_MOST,
    follow,
    place,
)
from tetractl.control.estimation.kernels.filter_state import (
    ACROSS,
    ALONG,
    FLOW_X,
    FLOW_Y,
    FOLLOWS,
    HEADING,
    HEADINGS,
    HELIX_COSINE,
    HELIX_SINE,
    HOST_SWING,
    LOG_FOLLOWS,
    MARKER_BIAS,
    POSITIONS,
    SIDE,
    STATES,
    SWING,
    TURN_BIAS,
    Bank,
    FilterModel,
    PoseFrames,
    SentCommands,
    X,
    Y,
)

pytestmark = pytest.mark.slow

STEP_S = 0.02
DEAD_TIMES_S = np.array([0.03, 0.07])
FRAMES = 30
PERIOD_S = 0.015


class Drive(NamedTuple):
    """Robots that are filmed while they follow directions, and their filters before that."""

    bank: Bank
    model: FilterModel
    commands: SentCommands
    frames: PoseFrames

    def followed(self, noisy=True):
        """The bank after all frames, and the ln of the likelihoods."""
        ln = follow(self.bank, self.model, self.commands, self.frames, noisy, STEP_S)
        return self.bank, ln


def model_of(case, robots=1, **changes):
    """What is assumed of one or two robots that differ, with some changes."""
    walk = np.linspace(0.02, 0.2, case.states)[:, None] * np.ones(robots)
    walk[Y] = walk[X]
    walk[FLOW_Y] = walk[FLOW_X]
    return filters.model_of(case, watchdog_s=0.12)._replace(
        parameters=np.array([[A, SPEED], [3.0, 200.0]])[:robots],
        noise=NOISE * np.array([1.0, 1.5])[:robots],
        walk=walk,
        **changes,
    )


def bank_of(case, robots=1, follows=FOLLOWS):
    """Filters for two dead times, whose robots stand somewhere."""
    mean = np.zeros((2, robots, STATES))
    for state, value in case.values.items():
        mean[..., state] = value
    mean[:, 1:, X] += 500.0
    mean[1, :, HEADING] += 0.05
    std = np.ones((robots, case.states))
    bank = Bank.start(DEAD_TIMES_S, mean, std, np.arange(2), follows)
    bank.cov[:] = some_covariance(case.states)
    bank.direction[..., 0] = 0.3
    bank.until_s[:] = 0.1
    return bank


def drive_of(name, seed=4, robots=1, **changes):
    """Robots that drive on a circle, roughly, with noise and some poses that are not valid."""
    case = CASES[name]
    rng = np.random.default_rng(seed)
    bank = bank_of(case, robots, LOG_FOLLOWS if changes.get("branch_all") else FOLLOWS)
    time_s = PERIOD_S * np.arange(FRAMES)[:, None] * np.ones(robots)
    headings = 0.5 + 0.9 * time_s
    x = bank.state[0, :, 0, X] + 250 * time_s
    y = bank.state[0, :, 0, Y] + 150 * time_s
    poses = np.stack([x, y, headings], axis=-1)
    poses += rng.normal(size=poses.shape) * NOISE[:, 0]
    directions = np.array([0.5, 1.2, 1.2, math.nan, -0.4])
    commands = SentCommands(np.array([-0.06, 0.05, 0.12, 0.2, 0.31]), directions)
    valid = rng.random((FRAMES, robots)) < 0.9
    return Drive(
        bank, model_of(case, robots, **changes), commands, PoseFrames(time_s, poses, valid)
    )


# ---- symmetries ----

MIRRORED = [Y, HEADING, SIDE, TURN_BIAS, MARKER_BIAS, FLOW_Y, HELIX_SINE, HELIX_COSINE]
KINDS = ["wheels", "saturated", "lagging", "longer lag", "no lag", "cell"]


def mirrored_states(state, cov):
    """States and covariances in a world that is mirrored in the x axis."""
    signs = np.ones(STATES)
    signs[[*MIRRORED, SWING, HOST_SWING]] = -1
    of_cov = signs[: cov.shape[-1]]
    return state * signs, cov * of_cov * of_cov[:, None]


def turned_states(state, cov, angle):
    """The same in a world that is turned about its origin."""
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, -s], [s, c]])
    whole = np.eye(STATES)
    for x, y in ((X, Y), (FLOW_X, FLOW_Y)):
        whole[np.ix_([x, y], [x, y])] = rotation
    turned = state @ whole.T
    turned[..., HEADING] += angle
    small = whole[: cov.shape[-1], : cov.shape[-1]]
    return turned, small @ cov @ small.T


def changed(drive, of_states, of_poses, of_directions):
    bank = drive.bank.copied()
    state, cov = of_states(bank.state, bank.cov)
    bank = bank._replace(
        state=state.copy(), cov=cov.copy(), direction=of_directions(bank.direction)
    )
    return drive._replace(
        bank=bank,
        commands=drive.commands._replace(directions=of_directions(drive.commands.directions)),
        frames=drive.frames._replace(poses=of_poses(drive.frames.poses)),
    )


def assert_same_motion(bank, ln, other, other_ln, of_states, of_directions):
    state, cov = of_states(bank.state, bank.cov)
    assert other.state == pytest.approx(state, rel=1e-6, abs=1e-6)
    sizes = np.sqrt(np.maximum(np.einsum("...ii->...i", cov), 1e-12))
    scale = sizes[..., None] * sizes[..., None, :]
    assert other.cov / scale == pytest.approx(cov / scale, abs=1e-6)
    assert other.direction == pytest.approx(of_directions(bank.direction), nan_ok=True)
    for name in ("ln_weight", "noise_scale", "unfit_s", "score", "until_s"):
        assert getattr(other, name) == pytest.approx(getattr(bank, name), rel=1e-6, abs=1e-6), name
    assert other.square_sum == pytest.approx(bank.square_sum, rel=1e-6, abs=1e-6)
    assert other_ln == pytest.approx(ln, rel=1e-6)


@pytest.mark.parametrize("branch_all", [False, True])
@pytest.mark.parametrize("name", KINDS)
def test_in_a_mirror_robots_are_followed_as_mirrored_ones(name, branch_all):
    drive = drive_of(name, branch_all=branch_all)
    signs = np.array([1, -1, -1])
    mirror = changed(drive, mirrored_states, lambda poses: poses * signs, np.negative)
    bank, ln = drive.followed()
    other, other_ln = mirror.followed()
    assert_same_motion(bank, ln, other, other_ln, mirrored_states, np.negative)
    assert other.block_sum == pytest.approx(bank.block_sum * [1, -1, -1], abs=1e-6)


@pytest.mark.parametrize("quarters", [1, 2, 3])
@pytest.mark.parametrize("name", KINDS)
def test_in_a_turned_world_robots_are_followed_as_turned_ones(name, quarters):
    angle = quarters * math.pi / 2
    drive = drive_of(name)

    def turned(state, cov):
        return turned_states(state, cov, angle)

    def turned_poses(poses):
        places = poses[..., :2] @ np.array(
            [[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]
        )
        return np.concatenate([places, poses[..., 2:] + angle], axis=-1)

    def turned_directions(directions):
        return directions + angle

    turned_drive = changed(drive, turned, turned_poses, turned_directions)
    bank, ln = drive.followed()
    other, other_ln = turned_drive.followed()
    assert_same_motion(bank, ln, other, other_ln, turned, turned_directions)
    assert other.block_sum == pytest.approx(bank.block_sum, abs=1e-6)


def test_each_of_two_robots_is_followed_as_if_it_were_alone():
    both = drive_of("wheels", robots=2)
    alone = []
    for robot in range(2):
        only = slice(robot, robot + 1)
        alone.append(
            Drive(
                Bank(*(values[:, only].copy() for values in both.bank)),
                both.model._replace(
                    parameters=both.model.parameters[only],
                    noise=both.model.noise[:, only].copy(),
                    walk=both.model.walk[:, only].copy(),
                ),
                both.commands,
                PoseFrames(*(values[:, only].copy() for values in both.frames)),
            ).followed()
        )
    bank, ln = both.followed()
    for robot, (of_one, ln_of_one) in enumerate(alone):
        assert ln[:, robot] == pytest.approx(ln_of_one[:, 0], rel=1e-9)
        for name, values in bank._asdict().items():
            expected = getattr(of_one, name)[:, 0]
            assert values[:, robot] == pytest.approx(expected, rel=1e-9, nan_ok=True), name


def test_it_does_not_matter_in_how_many_calls_frames_come():
    at_once, ln = drive_of("wheels").followed()
    drive = drive_of("wheels")
    total = 0.0
    for begin, end in ((0, 7), (6, 8), (7, FRAMES)):
        part = drive._replace(frames=drive.frames.part(begin, end))
        total = total + part.followed()[1]
    assert total == pytest.approx(ln)
    for name, values in drive.bank._asdict().items():
        assert values == pytest.approx(getattr(at_once, name), nan_ok=True), name


# ---- which poses are measurements ----


def standing(robots=2, frames=3, **changes):
    """Robots that stand, of which one is seen elsewhere by one standard deviation and a half."""
    case = CASES["wheels"]
    bank = bank_of(case, robots)
    bank.direction[:] = STANDS
    bank.cov[:] = 1e-3 * np.eye(case.states)
    poses = np.empty((frames, robots, 3))
    for robot in range(robots):
        pose = expected_pose(case, bank.state[0, robot, 0])
        poses[:, robot] = pose + np.array([7.0, 0.0, 0.0])
    time_s = PERIOD_S * np.arange(frames)[:, None] * np.ones(robots)
    valid = np.ones((frames, robots), np.bool_)
    commands = SentCommands(np.array([-5.0]), np.array([0.3]))
    bank.next_command[:] = 1
    model = model_of(case, robots, **changes)
    return Drive(bank, model, commands, PoseFrames(time_s, poses, valid))


def used(drive, noisy):
    """How many poses of each robot were used as measurements, by its first filter."""
    bank, _ = drive.followed(noisy)
    return (bank.block_frames[0] + BLOCK_FRAMES * bank.blocks[0]).tolist()


def test_poses_that_are_all_equal_to_those_before_are_a_frozen_frame():
    assert used(standing(), noisy=False) == [0, 0]


@pytest.mark.parametrize("robot", [0, 1])
@pytest.mark.parametrize("number", [X, Y, HEADING])
def test_if_a_single_number_differs_the_frame_is_new(robot, number):
    drive = standing()
    drive.frames.poses[1, robot, number] += 1e-9
    assert used(drive, noisy=False) == [2, 2]  # the last frame differs from it again
    drive = standing()
    drive.frames.poses[1, robot, number] += 1e-9
    noisy = [0, 0]  # what has noise never repeats
    noisy[robot] = 2
    assert used(drive, noisy=True) == noisy


def test_a_coarse_camera_may_repeat_poses():
    assert used(standing(coarse=True), noisy=True) == [2, 2]


def test_a_single_robot_without_noise_may_be_stuck():
    assert used(standing(robots=1), noisy=False) == [2]
    assert used(standing(robots=1), noisy=True) == [0]


@pytest.mark.parametrize(("before_s", "frozen"), [(0.06, True), (0.08, False)])
def test_robots_that_were_stopped_before_the_longest_dead_time_may_stand(before_s, frozen):
    drive = standing(frames=2)
    stop = SentCommands(np.array([-5.0, -before_s]), np.array([0.3, STANDS]))
    drive.bank.next_command[:] = 2
    assert used(drive._replace(commands=stop), noisy=False) == [0 if frozen else 1] * 2


def test_the_first_pose_of_the_frame_before_decides_whether_robots_stood():
    drive = standing(frames=2)
    drive.frames.time_s[0, 1] -= 0.05
    stop = SentCommands(np.array([-5.0, -0.08]), np.array([0.3, STANDS]))
    drive.bank.next_command[:] = 2
    assert used(drive._replace(commands=stop), noisy=False) == [0, 0]


def test_poses_that_are_not_valid_or_not_newer_are_none():
    drive = standing()
    drive.frames.poses[:, 0, X] += [0.0, 1.0, 2.0]
    drive.frames.valid[1, 1] = False
    drive.frames.time_s[2, 0] = drive.frames.time_s[1, 0]
    assert used(drive, noisy=False) == [1, 1]


def test_a_row_without_a_filter_stays_as_it_is():
    drive = drive_of("wheels")
    drive.bank.score[1] = -math.inf
    state = drive.bank.state[1].copy()
    bank, ln = drive.followed()
    assert np.array_equal(bank.state[1], state)
    assert ln[1, 0] == 0
    assert bank.score[:, 0].tolist() == [0, -math.inf]


def test_scores_are_relative_to_the_best_one():
    drive = drive_of("wheels")
    drive.bank.score[:, 0] = -3.0, -4.0
    bank, ln = drive.followed()
    assert bank.score.max() == 0
    gained = bank.score[:, 0] - [-3.0, -4.0]
    assert gained[1] - gained[0] == pytest.approx(ln[1, 0] - ln[0, 0])


# ---- innovations ----


def seen_off(along, across, turned, heading=0.8, frames=2):
    """The bank of a standing robot that is seen off its course, in standard deviations."""
    drive = standing(robots=1, frames=frames)
    case = CASES["wheels"]
    drive.bank.state[..., HEADING] = heading
    drive.bank.cov[:] = 1e-9 * np.eye(case.states)
    pose = expected_pose(case, drive.bank.state[0, 0, 0])
    c, s = math.cos(heading), math.sin(heading)
    deviations = np.array([c * along - s * across, s * along + c * across, turned])
    drive.frames.poses[:] = pose + NOISE[:, 0] * deviations
    return drive.followed(noisy=False)[0]


@pytest.mark.parametrize("heading", [0.0, 0.8, 2.5, -2.0])
def test_innovations_are_along_and_to_the_left_of_the_course(heading):
    block = seen_off(0.5, -0.25, 0.75, heading).block_sum[0, 0]
    assert block[[ALONG, ACROSS, HEADING]] == pytest.approx([0.5, -0.25, 0.75], rel=1e-6)


def test_a_full_block_adds_the_square_of_its_mean():
    bank = seen_off(0.5, -0.25, 0.75, frames=BLOCK_FRAMES)
    assert bank.blocks[0, 0] == 0
    assert bank.block_frames[0, 0] == BLOCK_FRAMES - 1
    bank = seen_off(0.5, -0.25, 0.75, frames=BLOCK_FRAMES + 1)
    assert (bank.blocks[0, 0], bank.block_frames[0, 0]) == (1, 0)
    assert not bank.block_sum[0, 0].any()
    squares = BLOCK_FRAMES * np.array([0.5, -0.25, 0.75]) ** 2
    assert bank.square_sum[0, 0] == pytest.approx(squares, rel=0.02)


def test_a_block_counts_no_more_than_five_standard_deviations():
    bank = seen_off(3.0, 0.1, -3.0, frames=BLOCK_FRAMES + 1)
    squares = bank.square_sum[0, 0]
    assert squares[[ALONG, HEADING]] == pytest.approx([MOST_SQUARE] * 2)
    assert squares[ACROSS] < 0.2


@pytest.mark.parametrize(
    ("off", "positions", "headings"),
    [((2.0, 0.0, 0.0), 1, -1), ((0.0, 2.0, 0.0), 1, -1), ((0.0, 0.0, 2.0), -1, 1)],
)
def test_positions_and_headings_have_noise_of_their_own(off, positions, headings):
    scale = seen_off(*off).noise_scale[0, 0]
    assert np.sign(scale[POSITIONS] - 1) == positions
    assert np.sign(scale[HEADINGS] - 1) == headings


def test_the_noise_stays_between_its_limits():
    for start, off in ((SCALE_LEAST, 0.0), (SCALE_MOST, 2.5)):
        drive = standing(robots=1)
        drive.bank.noise_scale[:] = start
        case = CASES["wheels"]
        pose = expected_pose(case, drive.bank.state[0, 0, 0])
        drive.frames.poses[:] = pose + off * NOISE[:, 0] * math.sqrt(start)
        assert (drive.followed(noisy=False)[0].noise_scale[0] == start).all()


def test_a_pose_that_fits_ends_the_time_without_one():
    bank = seen_off(0.1, 0.1, 0.1)
    assert bank.unfit_s[0, 0] == 0
    drive = standing(robots=1, frames=3)
    drive.frames.poses[1:, 0, X] += 1000.0
    bank, _ = drive.followed(noisy=False)
    assert bank.unfit_s[0, 0] == pytest.approx(2 * PERIOD_S)
    drive = standing(robots=1, frames=3)
    drive.frames.poses[1, 0, X] += 1000.0
    assert drive.followed(noisy=False)[0].unfit_s[0, 0] == 0


@pytest.mark.parametrize(("seconds", "restarts"), [(LOST_TRACK_S, False), (0.301, True)])
def test_a_robot_that_no_pose_fits_for_too_long_is_taken_from_the_camera(seconds, restarts):
    drive = standing(robots=1, frames=2)
    drive.frames.time_s[1] = seconds
    drive.frames.poses[1, 0] = 9000.0, 8000.0, 1.0
    bank, _ = drive.followed(noisy=False)
    marker = CASES["wheels"].values[MARKER_BIAS]
    if restarts:
        for slot in range(FOLLOWS + 1):
            assert bank.state[0, 0, slot, [X, Y]].tolist() == [9000, 8000]
            assert bank.state[0, 0, slot, HEADING] == pytest.approx(1.0 - marker)
            variances = np.diag(bank.cov[0, 0, slot])[:3]
            assert variances == pytest.approx(4 * NOISE[:, 0] ** 2)
        assert bank.unfit_s[0, 0] == 0
    else:
        assert bank.state[0, 0, 0, X] == CASES["wheels"].values[X]


# ---- the start ----


def test_placed_robots_get_the_pose_and_the_last_command_that_acts_and_others_nothing():
    case = CASES["wheels"]
    bank = bank_of(case, 2)
    before = bank.copied()
    model = model_of(case, 2)
    commands = SentCommands(np.array([0.0, 0.1, 0.2]), np.array([0.5, -0.5, 1.0]))
    poses = np.array([[1.0, 2.0, 0.3], [7.0, 8.0, 0.9]])
    time_s = np.array([9.0, 0.1 + DEAD_TIMES_S[1]])  # the second one just acts in filter 1
    place(bank, model, commands, time_s, poses, np.array([False, True]))
    for name, values in bank._asdict().items():
        untouched = getattr(before, name)[:, 0]
        assert np.array_equal(values[:, 0], untouched, equal_nan=True), name
    assert bank.next_command[:, 1].tolist() == [2, 2]
    assert (bank.direction[:, 1, :STUCK] == -0.5).all()
    assert np.isnan(bank.direction[:, 1, STUCK]).all()
    until_s = 0.1 + model.watchdog_s + DEAD_TIMES_S
    assert bank.until_s[:, 1, 0] == pytest.approx(until_s)
    assert bank.state[0, 1, 0, [X, Y]].tolist() == [7, 8]
    assert bank.state[0, 1, 0, HEADING] == pytest.approx(0.9 - case.values[MARKER_BIAS])
    cov = bank.cov[0, 1, 0]
    assert np.diag(cov)[:3] == pytest.approx(4 * model.noise[:, 1] ** 2)
    assert not cov[:3, 3:].any()
    assert not cov[3:, :3].any()
    assert np.array_equal(cov[3:, 3:], before.cov[0, 1, 0][3:, 3:])


def test_a_robot_to_which_nothing_was_sent_in_time_keeps_what_it_does():
    case = CASES["wheels"]
    bank = bank_of(case)
    commands = SentCommands(np.array([0.1]), np.array([-0.5]))
    place(bank, model_of(case), commands, np.array([0.12]), np.zeros((1, 3)), np.array([True]))
    assert bank.next_command[:, 0].tolist() == [0, 0]
    assert bank.direction[0, 0, 0] == 0.3
    assert bank.state[0, 0, 0, X] == 0
