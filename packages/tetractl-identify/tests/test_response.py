"""Tests that find how robots on two wheels follow their commands, from motions with known truth."""

from dataclasses import replace

import numpy as np
import pytest
from tetractl_identify.response import fit_responses
from tetractl_identify.robot_response import create_response_table
from tetractl_identify.step_regression import ResponseParameters
from tetractl_identify.tracks import Track, select_rows_apart
from tetractl_identify.unusual import USUAL_RANGES, describe_unusual_values

from tetractl.core.errors import UsageError
from tetractl.tools.likelihood import SampleInterval

TRUE = {
    "dead_time": 0.12,  # [s], as both lags
    "turning_lag": 0.08,
    "speed_lag": 0.15,
    "turning_gain": 0.93,
    "speed_gain": 1.04,
    "veer": 0.0004,  # [rad/mm]
    "heading_walk": 0.02,  # [rad/sqrt(s)]
    "way_walk": 2.0,  # [mm/sqrt(s)]
}
POSITION_NOISE_MM = 0.3
HEADING_NOISE_RAD = 0.003
TRACK_S = 30.0
COMMAND_PERIOD_S = 0.05
COMMANDS_PER_TWIST = 10
STEP_S = 0.005  # of the integration
STEPS_PER_FRAME = 4  # thus 50 frames a second


def random_twists(rng, count, commands_per_twist):
    """Speeds [mm/s] and turning rates [rad/s] (count, 2) that stay for some commands."""
    twists = rng.uniform((40, -1.5), (160, 1.5), (count // commands_per_twist, 2))
    return np.repeat(twists, commands_per_twist, axis=0)


def true_path(rng, times, sent, twists):
    """The poses (M, 3) at these times of a robot that is sent twists at the times `sent`.

    Its twist follows the one that acts with two lags; speed and turning rate are then multiplied by
    their gains, it veers with its speed, and both walk at random.
    """
    acting = np.searchsorted(sent, times + STEP_S / 2 - TRUE["dead_time"], side="right") - 1
    lags = np.array([TRUE["speed_lag"], TRUE["turning_lag"]])
    remaining = np.exp(-STEP_S / lags)
    walks = np.array([TRUE["way_walk"], TRUE["heading_walk"]]) * np.sqrt(STEP_S)
    random_steps = rng.standard_normal((len(times), 2)) * walks
    path = np.empty((len(times), 3))
    pose = np.zeros(3)
    twist = twists[0]
    for k, command in enumerate(twists[np.maximum(acting, 0)]):
        path[k] = pose
        next_twist = command + (twist - command) * remaining
        speed, rate = (twist + next_twist) / 2
        twist = next_twist
        way = STEP_S * TRUE["speed_gain"] * speed + random_steps[k, 0]
        turn_rate = TRUE["turning_gain"] * rate + TRUE["veer"] * speed
        turn = STEP_S * turn_rate + random_steps[k, 1]
        middle = pose[2] + turn / 2
        pose = pose + np.array([way * np.cos(middle), way * np.sin(middle), turn])
    return path


def track_of_one_robot(
    seed, commands_per_twist=COMMANDS_PER_TWIST, turns_s=TRACK_S, speed=None, twists=None
):
    """Commands at about 20 Hz, random ones by default, and noisy frames at 50."""
    rng = np.random.default_rng(seed)
    count = round(TRACK_S / COMMAND_PERIOD_S)
    sent = np.arange(count) * COMMAND_PERIOD_S + rng.uniform(0, 0.01, count)
    if twists is None:
        twists = random_twists(rng, count, commands_per_twist)
    twists[sent > turns_s, 1] = 0.0
    if speed is not None:
        twists[:, 0] = speed
    times = np.arange(0.0, TRACK_S, STEP_S)
    path = true_path(rng, times, sent, twists)[::STEPS_PER_FRAME]
    noise = (POSITION_NOISE_MM, POSITION_NOISE_MM, HEADING_NOISE_RAD)
    poses = path + rng.standard_normal(path.shape) * noise
    return Track(
        source="a test",
        origin="test",
        unit="mm",
        names=("one",),
        time_s=times[::STEPS_PER_FRAME],
        poses=poses[:, None],
        valid=np.ones((len(poses), 1), dtype=bool),
        stop_s=60.0,
        sent_s=sent,
        direction_rad=np.full(count, np.nan),
        twists=twists[:, None],
    )


@pytest.mark.long
def test_gains_lags_and_dead_time_are_found_and_intervals_hold_them():
    holds = []
    for seed in (1, 2):  # the walk of seed 0 is drawn 25 % too large
        (response,) = fit_responses([track_of_one_robot(seed)])
        values = response.quantities
        for name, true in TRUE.items():
            value = values[name]
            assert value.value == pytest.approx(true, rel=0.25, abs=2e-4), (seed, name)
            holds.append(value.low <= true <= value.high)
        assert values["turning_gain"].value == pytest.approx(TRUE["turning_gain"], rel=0.02)
    assert np.mean(holds) >= 0.8, holds


def width(interval):
    return interval.high - interval.low


@pytest.mark.long
def test_tracks_are_pooled_and_a_body_taken_for_another_is_left_out():
    disturbed = track_of_one_robot(4)
    clean = track_of_one_robot(5)
    (pooled,) = fit_responses([disturbed, clean])
    assert pooled.intervals == pytest.approx(2 * TRACK_S / 0.1, rel=0.02)  # of 0.1 s
    assert pooled.left_out == 0
    disturbed.poses[1000:1005] += (300.0, 0.0, 1.0)
    (response,) = fit_responses([disturbed, clean])
    assert response.left_out == 2  # to the other body and back
    (_, column) = create_response_table([response], "", "mm").columns
    assert column.values[-1] == f"2 of {response.intervals + 2}"
    assert width(response.dead_time) < 1.1 * width(pooled.dead_time)


# ---- Do the commands explain the motion? ----


def with_twists(track, twists):
    return replace(track, twists=twists)


REFUSED = {
    "of another robot": lambda _: track_of_one_robot(8).twists,
    "12 s late": lambda track: np.roll(track.twists, 240, axis=0),
    "w without its sign": lambda track: np.abs(track.twists),
}


@pytest.mark.long
@pytest.mark.parametrize("case", REFUSED)
def test_commands_that_do_not_explain_the_motion_are_refused_in_one_sentence(case):
    """Regression: a turning gain of 0.20 (0.09 to 0.31), without a word."""
    track = track_of_one_robot(7)
    with pytest.raises(
        UsageError, match="commands and the poses of one do not belong together"
    ) as e:
        fit_responses([with_twists(track, REFUSED[case](track))])
    assert "the turning" in str(e.value)
    assert "checklist" in (e.value.hint or "")


SCALED = {
    "w in degrees": ((1, 57.3), "turning gain of one is 0.016"),
    "w clockwise": ((1, -1), "turning gain of one is -0.9"),
    "v in m": ((1e-3, 1), "speed gain of one is 1.04e+03"),
    "v in cm": ((0.1, 1), "speed gain of one is 10.4"),
    "v reversed": ((-1, 1), "speed gain of one is -1"),
    "of wheels": ((1 / 15, 1 / 15), "turning gain of one is 1"),
    "40 %": ((2.5, 2.5), "turning gain of one is 0.37"),
}


@pytest.mark.long
@pytest.mark.parametrize("case", SCALED)
def test_values_far_from_what_is_usual_are_printed_with_the_factor_and_the_checklist(case):
    factors, says = SCALED[case]
    track = track_of_one_robot(7)
    (response,) = fit_responses([with_twists(track, track.twists * factors)])
    note = create_response_table([response], "", "mm").note
    assert says in note
    assert "checklist" in note


@pytest.mark.long
def test_speed_and_turning_rate_exchanged_are_not_given_as_if_right():
    track = track_of_one_robot(7)
    (response,) = fit_responses([with_twists(track, track.twists[..., ::-1] * (100, 0.01))])
    note = create_response_table([response], "", "mm").note
    assert "turning gain of one is 0.0388" in note
    assert "speed gain of one is" in note


@pytest.mark.long
@pytest.mark.parametrize("drift", [0.004, -0.002])
def test_a_clock_that_is_fast_is_found(drift):
    """Regression: a dead time of -0.12 (-0.23 to 0.00) s and a lag of 0.135 for 0.10 and 0.10."""
    track = track_of_one_robot(7)
    moved = replace(track, sent_s=track.sent_s * (1 + drift), has_two_clocks=True)
    (response,) = fit_responses([moved])
    assert response.clock_drift is not None
    assert response.clock_drift.low <= drift <= response.clock_drift.high
    assert response.turning_lag.low <= TRUE["turning_lag"] <= response.turning_lag.high
    note = create_response_table([response], "", "mm").note
    assert ("clock drift of one" in note) == (drift > 0.1 / TRACK_S)


@pytest.mark.long
def test_circles_to_one_side_give_wide_intervals_and_one_sentence():
    """Regression: "turning gain 26, as of a wrong unit", "moves 23 degrees to the right"."""
    track = track_of_one_robot(3)
    speeds = track.twists[..., :1]
    one_ratio = track_of_one_robot(3, twists=np.concatenate([speeds, 0.01 * speeds], axis=2)[:, 0])
    (response,) = fit_responses([one_ratio])
    for name in ("turning_gain", "speed_gain"):
        value = response.quantities[name]
        assert value.low <= TRUE[name] <= value.high
        assert width(value) > 0.8
    note = create_response_table([response], "", "mm").note
    assert "the data do not determine" in note
    assert "checklist" not in note


def with_motion_aside(track, angle, slip=0.0):
    """A track whose robot moves at an `angle` [rad] from its heading, and slips in turns by `slip`
    [rad s2/mm] times its speed times its turning rate."""
    times = track.time_s
    x, y, heading = track.poses[:, 0].T
    steps = np.diff(x + 1j * y)
    apart_s = np.diff(times)
    turned = np.diff(heading)
    # over 0.2 s, since the noise of single steps is no slip
    near = np.ones(10) / 10
    speed = np.convolve(np.abs(steps) / apart_s, near, "same")
    rate = np.convolve(turned / apart_s, near, "same")
    aside = steps * np.exp(1j * (angle + slip * speed * rate))
    path = np.concatenate([[0j], np.cumsum(aside)])
    poses = np.stack([path.real, path.imag, heading], axis=-1)
    return replace(track, poses=poses[:, None])


@pytest.mark.long
def test_a_car_that_slips_to_one_side_is_neither_refused_nor_called_rotated():
    """Regression: "the commands explain too little (34 % of the distance travelled)"."""
    rng = np.random.default_rng(21)
    to_the_left = random_twists(rng, round(TRACK_S / COMMAND_PERIOD_S), COMMANDS_PER_TWIST)
    to_the_left[:, 1] = np.abs(to_the_left[:, 1])
    track = track_of_one_robot(21, twists=to_the_left)
    (response,) = fit_responses([with_motion_aside(track, 0.0, slip=-0.006)])
    assert response.distance_explained.fraction is not None
    assert response.distance_explained.fraction > 0.9
    assert "checklist" not in create_response_table([response], "", "mm").note


@pytest.mark.long
@pytest.mark.parametrize(
    ("interval", "is_named"),
    [((550.0, 272.0, 828.0), True), ((35.0, -10.0, 81.0), False), ((1.3, 0.4, 2.2), False)],
)
def test_a_gain_that_is_hardly_known_is_named_if_it_is_surely_unusual(interval, is_named):
    """Regression: nothing was said of a speed gain of 550 (272 to 828)."""
    said = describe_unusual_values([("one", {"speed_gain": SampleInterval(*interval)})])
    assert ("speed gain of one is" in said) == is_named


def test_a_rotated_body_is_printed_with_the_checklist():
    (response,) = fit_responses([with_motion_aside(track_of_one_robot(22), 0.5)])
    assert response.heading_offset.value == pytest.approx(0.5, abs=0.02)
    note = create_response_table([response], "", "mm").note
    assert "heading offset of one is 0.5" in note
    assert "checklist" in note


@pytest.mark.long
def test_a_body_that_is_rotated_by_a_quarter_turn_is_refused():
    with pytest.raises(UsageError, match="of the distance travelled"):
        fit_responses([with_motion_aside(track_of_one_robot(23), np.pi / 2)])


def seen_twice_a_second(track):
    """Regression: a traceback."""
    at = slice(None, None, 25)
    return replace(track, time_s=track.time_s[at], poses=track.poses[at], valid=track.valid[at])


def half_the_poses_missing(track):
    return replace(track, valid=np.random.default_rng(9).uniform(size=track.valid.shape) < 0.5)


def scaled(track, poses, twists):
    return replace(track, poses=track.poses * poses, twists=track.twists * twists)


RIGHT_COMMANDS = {
    "obeyed by half": (  # which is no other unit
        lambda track: with_twists(track, track.twists * 2),
        {"turning_gain": 1 / 2, "speed_gain": 1 / 2},
    ),
    "obeyed thrice": (
        lambda track: with_twists(track, track.twists / 3),
        {"turning_gain": 3, "speed_gain": 3},
    ),
    "half of the poses missing": (half_the_poses_missing, {"turning_gain": 1}),
    "poses twice a second": (seen_twice_a_second, {"speed_gain": 1}),
    "backwards": (lambda track: scaled(track, (-1, -1, 1), (-1, 1)), {"speed_gain": 1}),
    "straight on, but for its veer": (
        lambda _: track_of_one_robot(7, turns_s=4.0),
        {"speed_gain": 1},
    ),
    "in metres": (lambda track: scaled(track, (1e-3, 1e-3, 1), (1e-3, 1)), {"speed_gain": 1}),
}


@pytest.mark.long
@pytest.mark.parametrize("case", RIGHT_COMMANDS)
def test_right_commands_that_come_nearest_to_wrong_ones_are_accepted(case):
    change, shares_of_gains = RIGHT_COMMANDS[case]
    (response,) = fit_responses([change(track_of_one_robot(7))])
    for name, share in shares_of_gains.items():
        assert response.quantities[name].value == pytest.approx(share * TRUE[name], rel=0.03)


@pytest.mark.long
def test_a_heading_that_jumps_by_less_than_robots_turn_is_left_out():
    """Regression: steps were left out only beyond the range of all turns that were sent."""
    track = track_of_one_robot(4, commands_per_twist=60)
    for amid_twist in (375, 675, 1125):
        track.poses[amid_twist : amid_twist + 5, 0, 2] += 0.2
    (response,) = fit_responses([track])
    assert response.left_out == 6  # there and back


@pytest.mark.long
def test_the_lag_of_a_speed_that_never_changes_has_no_upper_end():
    """Regression: an interval up to 89329781684117241856 s."""
    (response,) = fit_responses([track_of_one_robot(6, speed=100.0)])
    (_, column) = create_response_table([response], "", "mm").columns
    assert column.values[2].endswith("to ?)"), column.values[2]


@pytest.mark.long
@pytest.mark.parametrize("late_s", [0.2, 0.5, -2.0, 7.0])
def test_nothing_but_the_dead_time_depends_on_the_clocks(late_s):
    """Regression: of commands 0.5 s late, a dead time of -0.268 (-0.277 to -0.260) s for -0.405, a
    gain of 0.908 for 0.95; 0.2 s late, 0.869 for 0.917."""
    track = track_of_one_robot(7)
    (response,) = fit_responses([track])
    (moved,) = fit_responses([replace(track, sent_s=track.sent_s + late_s)])
    by_one_clock = response.dead_time.value
    assert moved.dead_time.value == pytest.approx(by_one_clock - late_s, abs=2e-3)
    for name in ("turning_gain", "speed_gain", "turning_lag"):
        value = response.quantities[name].value
        assert moved.quantities[name].value == pytest.approx(value, rel=0.01)
    note = create_response_table([moved], "", "mm").note
    _, latest = USUAL_RANGES["dead_time"]
    assert ("dead time of one is" in note) == (not 0 <= by_one_clock - late_s <= latest)


def test_steps_of_poses_at_unix_times_are_not_longer_by_rounding():
    """Regression: at 20 Hz, steps of 0.1 s were 0.15 s."""
    times_s = 1_764_000_000.25 + np.arange(200) / 20
    assert np.diff(select_rows_apart(times_s - times_s[0], 0.1)).tolist() == [2] * 99


def test_a_search_that_goes_far_astray_does_not_overflow():
    """Regression: "array must not contain infs or NaNs" ended the command with a traceback."""
    units = ResponseParameters(0.1, 0.1, 0.1, 0.02, 2.0, 0.003, 0.2, 0.0)
    with np.errstate(all="raise"):
        far = units.scaled_by(np.full(8, 1e6))
    assert np.isfinite([far.heading_walk**2, far.way_walk**2, far.turning_lag]).all()
