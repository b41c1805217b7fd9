"""Tests of what is made of a fit: checks before and after it, tables, doubts and a spec's section.

The fit itself stands still here: a robot has the values that a test gives it.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tetractl_identify import identify as module
from tetractl_identify.explained import Explained
from tetractl_identify.fit import FittedRobot
from tetractl_identify.identify import (
    DEFAULT_A,
    TOTAL_TURN_MIN_RAD,
    UNIFORM_DEVIATION_MAX_RAD,
    Doubt,
    IdentifiedRobots,
    cell,
    create_row_labels,
    create_spec_section,
    identify,
    is_turning_uniform,
    remove_unsure_intervals,
    tables,
)
from tetractl_identify.tracks import Track

from tetractl.core.errors import UsageError
from tetractl.tools.likelihood import SampleInterval

INF = math.inf


def interval(value, reach=0.01):
    return SampleInterval(value, value - reach, value + reach)


def robot(name="one", **values):
    """A robot as a fit finds it: its a is 4 rad/s and its speed 100 mm/s."""
    found = {
        "a": interval(4.0),
        "speed": interval(100.0),
        "heading_bias": interval(0.0),
        "position_noise": interval(0.1, 0.01),
        "heading_noise": interval(0.001, 0.0001),
        "heading_walk": interval(0.01),
        "lost": 3,
        "intervals": 200,
        "misfits": (),
    }
    return FittedRobot(name, **(found | values))


def result(*robots, **fields):
    found = {
        "origin": "CSV",
        "sources": ("p.csv",),
        "unit": "mm",
        "commands": 9,
        "dead_time": interval(0.1),
        "frame_age": None,
        "robots": robots or (robot(),),
    }
    return IdentifiedRobots(**(found | fields))


# tracks


RATE = 20
PERIOD_S = 0.25
LONG_S = 20.0
DEAD_TIME_S = 0.1


TRUE_A = (4.0, 2.0)
TRUE_SPEED = (100.0, 60.0)
SUBSTEPS = 4


@cache
def _driven(seed):
    """Robots that follow random directions by the paper's equations, without noise."""
    sent = np.arange(0, LONG_S, PERIOD_S)
    u = np.random.default_rng(seed).uniform(-2, 2, len(sent))
    dt = 1 / (SUBSTEPS * RATE)
    times = np.arange(0, LONG_S, dt)
    newest = np.maximum(np.searchsorted(sent, times - DEAD_TIME_S, side="right") - 1, 0)
    pose = np.zeros((2, 3))
    path = np.empty((len(times), 2, 3))
    for k, direction in enumerate(u[newest]):
        path[k] = pose
        turn = TRUE_A * np.sin(direction - pose[:, 2]) * dt
        middle = pose[:, 2] + turn / 2
        way = np.array(TRUE_SPEED) * dt
        pose = pose + np.column_stack([way * np.cos(middle), way * np.sin(middle), turn])
    path = path[::SUBSTEPS]
    return Track(
        source="p.csv",
        origin="CSV",
        unit="mm",
        names=("one", "two"),
        time_s=times[::SUBSTEPS],
        poses=path,
        valid=np.ones(path.shape[:2], dtype=bool),
        sent_s=sent,
        direction_rad=u,
        stop_s=LONG_S,
    )


def driven(seed=1, **fields):
    track = _driven(seed)
    return replace(track, poses=track.poses.copy(), **fields)


@pytest.fixture
def fitted(monkeypatch):
    """Let a fit find these values; what it is asked is in the dictionary that a test gets."""
    asked = {
        "dead_time": interval(DEAD_TIME_S),
        "robots": (
            robot("one"),
            robot("two", a=interval(2.0), speed=interval(60.0)),
        ),
    }

    def fit(frames, names, a, speed, dead_time, all_commands):
        asked["given"] = (names, a, speed, dead_time, all_commands)
        return asked["dead_time"], asked["robots"]

    monkeypatch.setattr(module, "fit", fit)
    return asked


A = np.array([4.0, 2.0])


def test_robots_that_follow_their_directions_are_explained(fitted):
    found = identify([driven()], A)
    for explained in (*found.turning_explained, *found.distance_explained):
        assert explained.fraction == pytest.approx(1.0, abs=0.02)
    assert found.robots == fitted["robots"]
    assert found.dead_time == fitted["dead_time"]
    assert found.doubt is None


def test_a_fit_gets_the_expected_values_and_the_measured_speeds(fitted):
    identify([driven()], A, 0.2)
    names, a, speed, dead_time, all_commands = fitted["given"]
    assert names == ("one", "two")
    assert a is A
    assert speed == pytest.approx([100, 60], rel=0.01)
    assert dead_time == 0.2
    assert all_commands is True
    identify([driven(), driven(2, has_all_commands=False)], None)
    _, a, _, dead_time, all_commands = fitted["given"]
    assert a.tolist() == [DEFAULT_A, DEFAULT_A]
    assert dead_time == 0.05
    assert all_commands is False


WRONG = {
    "turns to the other side": ({"a": interval(-4.0)}, "one: 0% of the turning"),
    "turns towards another direction": ({"heading_bias": interval(2.5)}, "of the turning"),
    "is called three times as fast": ({"speed": interval(300.0)}, "one: 0% of the distance"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_robot_whose_values_explain_too_little_is_refused_by_its_name(fitted, case):
    values, says = WRONG[case]
    fitted["robots"] = (robot("one", **values), fitted["robots"][1])
    with pytest.raises(UsageError, match=r"p\.csv: the commands and the poses of one do") as caught:
        identify([driven()], A)
    assert says in caught.value.message
    assert "two" not in caught.value.message


def test_both_motions_that_are_not_explained_are_named(fitted):
    wrong = robot("two", a=interval(-2.0), speed=interval(300.0))
    fitted["robots"] = (fitted["robots"][0], wrong)
    with pytest.raises(UsageError, match="of the turning and 0% of the distance travelled"):
        identify([driven()], A)


def test_a_dead_time_far_off_explains_no_turning(fitted):
    fitted["dead_time"] = interval(1.3)
    with pytest.raises(UsageError, match="of the turning"):
        identify([driven()], A)


def test_a_gap_in_the_poses_is_not_judged(fitted):
    valid = np.ones((len(driven().time_s), 2), dtype=bool)
    valid[200:260] = False
    found = identify([driven(valid=valid)], A)
    for explained in (*found.turning_explained, *found.distance_explained):
        assert explained.fraction == pytest.approx(1.0, abs=0.02)


def test_the_commands_and_ages_of_all_tracks_are_pooled(fitted):
    tracks = [
        driven(1, frame_age_s=0.03, source="a.csv", commands_source="b.csv"),
        driven(2, frame_age_s=None, source="c.csv"),
        driven(3, frame_age_s=0.05, source="d.csv", origin="lab"),
        driven(4, frame_age_s=0.04, source="e.csv"),
    ]
    found = identify(tracks, A)
    assert found.commands == 4 * len(tracks[0].direction_rad)
    assert found.frame_age == pytest.approx(0.04)
    assert found.sources == ("a.csv", "c.csv", "d.csv", "e.csv")
    assert found.origin == "CSV, lab"
    assert identify([driven()], A).frame_age is None


def test_a_doubt_of_one_track_is_a_doubt_of_all(fitted):
    assert identify([driven(1), driven(2, rates_unstated=True)], A).doubt is Doubt.RATES_UNSTATED
    assert identify([driven(1), driven(2)], A).doubt is None


@pytest.mark.parametrize(
    ("on_wheels", "lag", "turns_as_lagging", "may_lag"),
    [
        (True, 0.0, True, True),
        (True, 0.0, False, False),
        (True, 0.04, True, False),
        (False, 0.0, True, False),
    ],
)
def test_a_lag_is_doubted_only_on_wheels_whose_lag_nothing_states(
    fitted, monkeypatch, on_wheels, lag, turns_as_lagging, may_lag
):
    monkeypatch.setattr(
        module, "may_lag_explain_turns", lambda tracks, dead_time_s: turns_as_lagging
    )
    assert identify([driven(on_wheels=on_wheels, lag_s=lag)], A).may_lag is may_lag


def test_the_strength_of_the_field_is_that_of_the_tracks(fitted):
    found = identify([driven(strength=2.0, strength_unit="V/cm")], A)
    assert (found.strength, found.strength_unit) == (2.0, "V/cm")


@pytest.mark.parametrize(("seconds", "is_enough"), [(1.05 + 1e-6, True), (1.0 + 1e-6, False)])
def test_robots_must_drive_in_at_least_twenty_intervals(fitted, seconds, is_enough):
    track = driven(stop_s=seconds)
    if is_enough:
        assert identify([track], A).robots
        return
    with pytest.raises(UsageError, match=r"robot one drives in only 1\d intervals") as caught:
        identify([track], A)
    assert "at least 20 intervals are needed" in caught.value.hint


def test_the_second_robot_is_checked_too(fitted):
    standing = driven()
    standing.poses[:, 1] = standing.poses[0, 1]
    with pytest.raises(UsageError, match="robot two does not move"):
        identify([standing], A)


# directions that turn at one rate


def directions(*all_u, apart_s=0.1):
    empty = np.empty(0)
    return [
        Track(
            source="c.csv",
            origin="CSV",
            unit="mm",
            names=(),
            time_s=empty,
            poses=np.empty((0, 0, 3)),
            valid=np.empty((0, 0), dtype=bool),
            sent_s=5.0 + apart_s * np.arange(len(u)),
            direction_rad=np.asarray(u, dtype=float),
            stop_s=60.0,
        )
        for u in all_u
    ]


LINE = np.linspace(0, 4, 100)


@pytest.mark.parametrize(
    ("off", "uniform"), [(0.9, True), (-0.9, True), (1.2, False), (-1.2, False)]
)
def test_directions_near_a_straight_line_turn_uniformly(off, uniform):
    bent = LINE + off * UNIFORM_DEVIATION_MAX_RAD * np.cos(np.linspace(0, 8 * np.pi, 100))
    assert is_turning_uniform(directions(bent)) == uniform


@pytest.mark.parametrize(("jump", "uniform"), [(0.9, True), (1.1, False)])
def test_directions_that_jump_do_not_turn_uniformly(jump, uniform):
    steps = jump * UNIFORM_DEVIATION_MAX_RAD * np.arange(12)
    assert is_turning_uniform(directions(steps)) == uniform
    assert is_turning_uniform(directions(-steps)) == uniform


@pytest.mark.parametrize(("turn", "uniform"), [(1.01, True), (0.99, False), (0.0, False)])
def test_directions_that_hardly_turn_do_not_turn_uniformly(turn, uniform):
    assert is_turning_uniform(directions(np.linspace(0, turn * TOTAL_TURN_MIN_RAD, 50))) == uniform


def test_few_directions_or_directions_of_one_time_do_not_turn_uniformly():
    assert not is_turning_uniform(directions([0.0, 0.15]))
    assert not is_turning_uniform(directions(LINE, apart_s=0.0))


@pytest.mark.parametrize(("factor", "uniform"), [(1.09, True), (1.11, False), (-1.05, True)])
def test_tracks_must_turn_at_the_same_rate(factor, uniform):
    assert is_turning_uniform(directions(LINE, factor * LINE)) == uniform
    assert is_turning_uniform(directions(factor * LINE, LINE)) == uniform


def test_one_track_that_does_not_turn_uniformly_is_enough():
    other = np.random.default_rng(1).uniform(-2, 2, 50)
    assert not is_turning_uniform(directions(LINE, other))
    assert not is_turning_uniform(directions(other, LINE))


# doubts and intervals


@pytest.mark.parametrize(
    ("flags", "doubt"),
    [
        ((), None),
        (("may_lag",), Doubt.LAG_UNSTATED),
        (("may_lag", "rates_unstated"), Doubt.RATES_UNSTATED),
        (("may_lag", "rates_unstated", "turns_uniformly"), Doubt.UNIFORM_TURNS),
    ],
)
def test_the_first_reason_for_doubt_counts(flags, doubt):
    assert result(**dict.fromkeys(flags, True)).doubt is doubt


def test_without_a_doubt_only_noise_of_headings_loses_its_interval():
    sure = remove_unsure_intervals(result(robot("one"), robot("two")))
    assert sure.dead_time == interval(0.1)
    for found in sure.robots:
        assert (found.a, found.heading_bias) == (interval(4.0), interval(0.0))
        assert (found.speed, found.position_noise) == (interval(100.0), interval(0.1))
        for unsure in (found.heading_noise, found.heading_walk):
            assert math.isnan(unsure.low)
            assert math.isnan(unsure.high)
        assert found.heading_walk.value == 0.01


# a spec's section


def test_a_section_of_a_spec_has_the_values_of_each_robot():
    found = result(robot("one"), robot("two", a=interval(2.0)), frame_age=0.03, strength=2.0)
    section = create_spec_section(found, "now")
    assert (section.identified, section.origin, section.unit) == ("now", "CSV", "mm")
    assert section.sources == ("p.csv",)
    assert (section.frame_age, section.strength) == (0.03, 2.0)
    assert {name: each.a.value for name, each in section.robots.items()} == {"one": 4.0, "two": 2.0}
    a = section.robots["one"].a
    assert (a.low, a.high) == (3.99, 4.01)
    assert section.robots["one"].speed.value == 100.0
    assert create_spec_section(result(), "now").frame_age == 0.0


def test_an_end_that_is_not_known_is_left_out_of_a_spec():
    ends = [(0.0, INF), (-INF, 1.0), (math.nan, math.nan)]
    for low, high in ends:
        a = (
            create_spec_section(result(robot(a=SampleInterval(0.5, low, high))), "now")
            .robots["one"]
            .a
        )
        assert a.value == 0.5
        assert a.low == (low if math.isfinite(low) else None)
        assert a.high == (high if math.isfinite(high) else None)


def test_a_dead_time_in_a_spec_is_never_negative():
    dead_time = create_spec_section(
        result(dead_time=SampleInterval(-0.01, -0.02, 0.03)), "now"
    ).dead_time
    assert (dead_time.value, dead_time.low, dead_time.high) == (0.0, 0.0, 0.03)
    kept = create_spec_section(result(dead_time=SampleInterval(0.1, 0.05, 0.2)), "now").dead_time
    assert (kept.value, kept.low, kept.high) == (0.1, 0.05, 0.2)


# tables


@pytest.mark.parametrize(
    ("ends", "text"),
    [
        ((1.2345, 1.2, 1.3), "1.234 (1.200 to 1.300)"),
        ((1.2345, 1.0, 1.3), "1.23 (1.00 to 1.30)"),
        ((123.45, 80.0, 160.0), "123 (80 to 160)"),
        ((123.45, 122.0, 125.0), "123.5 (122.0 to 125.0)"),
        ((0.5, 0.5 - 1e-9, 0.5 + 1e-9), "0.500000 (0.500000 to 0.500000)"),
        ((0.5, 0.5, 0.5), "0.500 (0.500 to 0.500)"),
        ((0.5, 0.0, INF), "0.50 (0.00 to ?)"),
        ((0.5, -INF, 0.9), "0.50 (? to 0.90)"),
        ((0.5, -INF, INF), "0.500 (? to ?)"),
        ((0.0123, math.nan, math.nan), "0.012"),
        ((5.0, 4.0, 6.0), "5.0 (4.0 to 6.0)"),
        ((5000.0, 4000.0, 6000.0), "5000 (4000 to 6000)"),
    ],
)
def test_a_value_is_rounded_to_two_digits_of_half_its_interval(ends, text):
    assert cell(SampleInterval(*ends)) == text


def test_labels_have_units_if_there_are_any():
    labels = create_row_labels(
        {"speed_gain": "", "speed": "{unit}/s", "way_walk": "{unit}/sqrt(s)"}, "um"
    )
    assert labels == ["speed gain", "speed [um/s]", "way walk [um/sqrt(s)]"]


@pytest.mark.parametrize(("count", "columns"), [(1, [1]), (3, [3]), (4, [3, 1]), (7, [3, 3, 1])])
def test_at_most_three_robots_stand_side_by_side(count, columns):
    found = tables(result(*(robot(f"r{i}") for i in range(count))))
    assert [len(table.columns) - 1 for table in found] == columns
    names = [column.name for table in found for column in table.columns[1:]]
    assert names == [f"r{i}" for i in range(count)]


def test_a_column_has_an_entry_for_each_label():
    full = Explained(0.97, 0.0, 1.0)
    none = Explained(None, 0.0, 0.0)
    found = result(
        robot("one"), robot("two", lost=8), strength=2.0, strength_unit="V/cm",
        turning_explained=(full, none), distance_explained=(none, full),
    )  # fmt: skip
    (table,) = tables(found)
    labels, one, two = (column.values for column in table.columns)
    assert labels[:2] == ["a [rad/s]", "speed [mm/s]"]
    assert labels[6:] == [
        "lost", "turning explained", "distance explained", "a per strength [rad/(s V/cm)]",
    ]  # fmt: skip
    assert one[6:] == ["3", "97%", "-", "2.0000 (1.9950 to 2.0050)"]
    assert two[6:9] == ["8", "-", "97%"]
    plain = tables(result())[0]
    assert plain.columns[1].values[7:] == ["-", "-"]


def test_the_title_counts_logs_and_directions():
    assert tables(result())[0].title == "1 log, 9 directions: CSV; 95 % intervals"
    two = tables(result(sources=("a", "b")))[0]
    assert two.title.startswith("2 logs, ")


def test_unusual_values_of_all_and_of_each_robot_are_named_below():
    note = tables(result(robot("one"), robot("two", a=interval(80.0)), dead_time=interval(0.9)))[
        0
    ].note
    assert "the dead time of all robots is 0.9" in note
    assert "the a of two is 80" in note
    assert "of one" not in note
    assert "checklist" not in tables(result())[0].note
    bias = tables(result(robot(heading_bias=interval(1.0))))[0].note
    assert "the heading bias of one is 1" in bias


def test_a_doubt_is_explained_below_and_nothing_else_is():
    assert "have no intervals" not in tables(result())[0].note
    assert "lag_s in a table" in tables(result(may_lag=True))[0].note
    assert replace(result(), may_lag=True).doubt is Doubt.LAG_UNSTATED
