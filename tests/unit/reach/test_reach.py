"""Tests of what the common signal can reach, and of which robots move in the same way."""

import sys
from collections import Counter

import pytest
from testkit.trials import THREE_M3PI, experiment

from tetractl.core import elementary
from tetractl.reach.facts import facts_items, facts_table, most_similar
from tetractl.reach.reach import ROBOTS_MAX, reach

ROBOTS = THREE_M3PI["robots"]
NAMES = tuple(robot["name"] for robot in ROBOTS)


def three_robots(a=(6, 4, 3), speed=(200, 200, 200), **fields):
    """An experiment with these turning rates [rad/s] and speeds [mm/s]."""
    robots = [
        robot | {"a": float(rate), "speed": float(robot_speed)}
        for robot, rate, robot_speed in zip(ROBOTS, a, speed, strict=True)
    ]
    return experiment(robots=robots, **fields)


@pytest.fixture
def few_sequences(monkeypatch):
    """Enough to tell which robots are alike."""
    monkeypatch.setattr("tetractl.reach.reach.SEQUENCE_COUNT", 80)


@pytest.fixture(scope="module")
def reached_by_equals():
    """What three robots reach that turn equally fast."""
    return reach(three_robots(a=(6, 6, 6)))


def test_robots_that_differ_can_be_steered_apart():
    """Each robot has two coordinates."""
    reached = reach(three_robots())
    assert reached.rank == 6
    assert reached.barely == 0
    assert reached.identical == ()
    assert reached.still == ()
    assert str(reached) == "6 of 6"


def test_robots_alike_are_named(reached_by_equals):
    assert reached_by_equals.rank == 2
    assert reached_by_equals.identical == (NAMES,)
    assert str(reached_by_equals).startswith("2 of 6; ")
    assert "move in the same way" in str(reached_by_equals)


def test_the_rates_advised_part_robots_that_are_alike(reached_by_equals):
    advised = [robot.a_advised for robot in reached_by_equals.separable]
    parted = reach(three_robots(a=(6, *advised)))
    assert parted.rank == 6
    assert parted.identical == ()


def test_a_robot_that_does_not_move_is_named():
    reached = reach(three_robots(speed=(200, 0, 200)))
    assert reached.rank == 4
    assert reached.still == (NAMES[1],)
    assert str(reached) == f"4 of 6; {NAMES[1]} has speed 0"


def least_spread(difference):
    """The spread in the direction that is hardest to reach, of rates that differ by a share."""
    return reach(three_robots(a=(6, 6 * (1 + difference), 3))).spread[-1]


def test_the_spread_grows_with_the_difference_and_not_with_rare_sequences():
    """Regression: it was the root of what a few sequences of a thousand contribute, which near an
    unstable direction part even robots that hardly differ."""
    assert 1.7 < least_spread(0.004) / least_spread(0.002) < 2.3


@pytest.mark.parametrize("motion", ["exact", "euler"])
@pytest.mark.parametrize(("a", "rank"), [((6, 4, 3), 6), ((6, 6, 3), 4)])
def test_any_motion_has_a_verdict(motion, a, rank):
    controller = {"type": "pso-mpc", "motion": motion}
    assert reach(three_robots(a, controller=controller)).rank == rank


def test_the_two_most_similar_robots_differ_least_in_a():
    setup = three_robots().setup
    slower, faster = most_similar(setup)
    assert (setup.a[slower], setup.a[faster]) == (3, 4)
    assert most_similar(setup.select_robots([0])) is None


@pytest.mark.usefixtures("few_sequences")
def test_facts_of_similar_robots_are_the_same_in_text_and_json():
    spec = three_robots(a=(6, 6, 3))
    rows = dict(facts_table(spec).rows)
    items = facts_items(spec)
    assert rows["reach of the signal"] == str(reach(spec))
    assert items["reach"]["rank"] == 4
    assert rows["smallest difference of a"] == f"0 % ({NAMES[0]}, {NAMES[1]})"
    assert (items["most_similar"], items["smallest_difference"]) == (list(NAMES[:2]), 0)


def test_the_motion_of_all_sequences_is_computed_by_operations_of_arrays():
    """Regression: 3 million calls of plain functions, one for each number, took 1.5 s."""
    calls = Counter()

    def count(frame, event, argument):
        if event == "call" and frame.f_code.co_filename == elementary.__file__:
            calls["plain"] += 1

    spec = three_robots()
    before = sys.getprofile()
    sys.setprofile(count)
    try:
        reach(spec)
    finally:
        sys.setprofile(before)
    assert 0 < calls["plain"] < 10_000


def test_robots_that_hardly_differ_are_reached_barely():
    one_percent_more = 6.06
    assert reach(three_robots(a=(6, one_percent_more, 3))).barely > 0


def test_of_very_many_robots_nothing_is_said():
    robots = [
        ROBOTS[0] | {"name": f"r{i}", "start": [100.0 + i, 100.0]} for i in range(ROBOTS_MAX + 1)
    ]
    assert reach(experiment(robots=robots)) is None


@pytest.mark.usefixtures("few_sequences")
def test_as_many_robots_as_are_allowed_have_a_verdict(monkeypatch):
    monkeypatch.setattr("tetractl.reach.reach.ROBOTS_MAX", 3)
    assert reach(three_robots()) is not None
    monkeypatch.setattr("tetractl.reach.reach.ROBOTS_MAX", 2)
    assert reach(three_robots()) is None


@pytest.mark.usefixtures("few_sequences")
def test_two_of_three_robots_alike_are_a_group_and_the_third_is_none():
    for a, group in (((6, 6, 3), NAMES[:2]), ((3, 6, 6), NAMES[1:]), ((6, 3, 6), NAMES[::2])):
        reached = reach(three_robots(a=a))
        assert reached.identical == (group,)
        assert {parting.robot for parting in reached.separable} == {group[1]}
        (parting,) = reached.separable
        assert parting.a == 6
        assert parting.a_advised > 6
        assert f"{group[0]} and {group[1]} move in the same way" in str(reached)
        assert f"from {parting.a:.4g} to {parting.a_advised:.4g}" in str(reached)
        assert "still would" not in str(reached)


@pytest.mark.usefixtures("few_sequences")
def test_two_pairs_of_robots_alike_are_two_groups():
    robots = [
        ROBOTS[i % 3] | {"name": name, "a": rate, "speed": 200.0, "start": [700 + 90 * i, 500]}
        for i, (name, rate) in enumerate(zip("stuv", (6.0, 3.0, 6.0, 3.0), strict=True))
    ]
    assert set(reach(experiment(robots=robots)).identical) == {("s", "u"), ("t", "v")}


@pytest.mark.usefixtures("few_sequences")
def test_the_speed_and_the_place_of_robots_do_not_matter_but_their_headings_do():
    """Ends count relative to speeds. Robots with other headings at first can be distinguished."""
    alike = reach(three_robots(a=(6, 6, 6), speed=(100, 200, 300)))
    assert alike.identical == (NAMES,)
    robots = [
        robot | {"a": 6.0, "heading": heading}
        for robot, heading in zip(ROBOTS, (0, 1, 2), strict=True)
    ]
    assert reach(experiment(robots=robots)).rank > 2


@pytest.mark.usefixtures("few_sequences")
def test_robots_that_all_stand_reach_nothing():
    reached = reach(three_robots(speed=(0, 0, 0)))
    assert reached.rank == 0
    assert reached.still == NAMES
    assert reached.identical == ()


@pytest.mark.usefixtures("few_sequences")
def test_the_json_fields_are_those_of_the_verdict():
    reached = reach(three_robots(a=(6, 6, 3)))
    fields = reached.fields
    assert (fields["rank"], fields["of"]) == (reached.rank, 6)
    assert fields["barely"] == reached.barely
    assert fields["alike"] == [NAMES[:2]]
    assert fields["spread"] == reached.spread.tolist()
    assert fields["spread"][0] == 1
    assert sorted(fields["spread"], reverse=True) == fields["spread"]
    assert [parting["robot"] for parting in fields["parted"]] == [NAMES[1]]
