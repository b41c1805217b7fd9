"""Tests of what is said about a spec's robots together, before a trial."""

import pytest
from testkit.trials import THREE_M3PI, experiment

from tetractl.reach.facts import facts_items, facts_table, most_similar
from tetractl.reach.reach import reach
from tetractl.spec.experiment import Experiment

ROBOTS = THREE_M3PI["robots"]


@pytest.fixture(autouse=True)
def few_short_sequences(monkeypatch):
    """What is said here needs no exact spread."""
    monkeypatch.setattr("tetractl.reach.reach.SEQUENCE_COUNT", 20)
    monkeypatch.setattr("tetractl.reach.reach.SEQUENCE_LENGTH", 8)


def robots_of(*rates):
    names = ("green", "blue", "red")
    return [
        robot | {"name": name, "a": rate}
        for robot, name, rate in zip(ROBOTS, names, rates, strict=False)
    ]


@pytest.mark.parametrize(
    ("rates", "pair", "difference"),
    [
        ((4.0, 5.0, 6.0), ("blue", "red"), 0.2),  # the difference counts relative to the slower
        ((6.0, 5.0, 4.0), ("blue", "green"), 0.2),
        ((3.0, 6.0, 3.3), ("green", "red"), 0.1),
        ((5.0, 5.0, 5.0), ("green", "blue"), 0.0),  # the first ones
        ((2.0, 8.0), ("green", "blue"), 3.0),
    ],
)
def test_the_most_similar_robots_are_named_slower_first(rates, pair, difference):
    spec = experiment(robots=robots_of(*rates))
    slower, faster = most_similar(spec.setup)
    assert (spec.setup.names[slower], spec.setup.names[faster]) == pair
    items = facts_items(spec)
    assert items["most_similar"] == list(pair)
    assert items["smallest_difference"] == pytest.approx(difference)
    rows = dict(facts_table(spec).rows)
    shown = f"{100 * difference:.3g} % ({', '.join(pair)})"
    assert rows["smallest difference of a"] == shown


def test_of_a_single_robot_no_difference_is_said():
    spec = experiment(robots=robots_of(4.0))
    rows = dict(facts_table(spec).rows)
    assert list(rows) == ["reach of the signal"]
    assert facts_table(spec).title == "three-m3pi: 1 robot"
    items = facts_items(spec)
    assert (items["most_similar"], items["smallest_difference"]) == ([], None)
    assert items["reach"] == reach(spec).fields


def test_the_title_counts_the_robots():
    assert facts_table(experiment()).title == "three-m3pi: 3 robots"


def cells(a, speed, **fields):
    """Robots that cannot stand still, with rates of turning [rad/s] and speeds."""
    robots = [
        {"name": name, "start": [10, 10 * i + 10], "target": [40, 40], "a": rate, "speed": v}
        for i, (name, rate, v) in enumerate(zip("pq", a, speed, strict=True))
    ]
    arena = {"left": 0, "bottom": 0, "width": 1000, "height": 1000}
    units = {"length": "um"}
    text = {"robots": robots, "arena": arena, "units": units, "obstacles": []}
    return experiment(**text, **fields)


def test_cells_that_hold_circle_with_the_slowest_turning_of_them():
    """The smallest circle that all can drive together has the radius v over the least a."""
    hold = {"time": 10, "radius": 200}
    spec = cells((4.0, 2.0), (100.0, 50.0), hold=hold, controller={"type": "mpc"})
    assert not spec.setup.on_wheels
    rows = dict(facts_table(spec).rows)
    assert rows["radii of the smallest circles [um]"] == "p 50, q 25"
    without_hold = cells((4.0, 2.0), (100.0, 50.0))
    assert not [name for name in dict(facts_table(without_hold).rows) if "circles" in name]


def test_of_robots_on_wheels_no_circles_are_said():
    spec = experiment(
        hold={"time": 10, "radius": 50}, wheels={"radius": 40}, controller={"type": "mpc"}
    )
    assert spec.setup.on_wheels
    assert not [name for name in dict(facts_table(spec).rows) if "circles" in name]


@pytest.mark.parametrize("found", [True, False])
def test_of_robots_that_are_still_to_be_found_nothing_is_said(found, monkeypatch):
    monkeypatch.setattr(Experiment, "must_choose_robots", not found)
    spec = experiment()
    nothing = {"reach": None, "most_similar": [], "smallest_difference": None}
    assert (facts_table(spec) is not None) == found
    assert (facts_items(spec) != nothing) == found
