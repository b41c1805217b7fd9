"""What the common signal can reach, and which robots move alike."""

import pytest
from support.trials import THREE_M3PI, experiment

from tetractl.analysis.analysis_text import as_json, tables
from tetractl.analysis.analyze import analyze
from tetractl.analysis.reach import ROBOTS_MAX, reach


def of(a=(6, 4, 3), speed=(200, 200, 200), controller=None):
    robots = [
        robot | {"a": float(rate), "speed": float(v)}
        for robot, rate, v in zip(THREE_M3PI["robots"], a, speed, strict=True)
    ]
    return experiment(robots=robots, **({"controller": controller} if controller else {}))


def test_robots_that_differ_can_be_steered_apart():
    found = reach(of())
    assert (found.rank, found.barely, found.alike, found.still) == (6, 0, (), ())
    assert str(found) == "6 of 6"


def test_robots_alike_are_named_with_what_would_part_them():
    found = reach(of(a=(6, 6, 6)))
    assert found.rank == 2
    assert found.alike == (tuple(robot["name"] for robot in THREE_M3PI["robots"]),)
    rates = [6.0, *(robot.a_advised for robot in found.parted)]
    assert str(found).startswith("2 of 6; ")
    assert "move alike" in str(found)
    parted = reach(of(a=rates))
    assert (parted.rank, parted.alike) == (6, ())


def test_a_robot_that_does_not_move_is_named():
    found = reach(of(speed=(200, 0, 200)))
    name = THREE_M3PI["robots"][1]["name"]
    assert (found.rank, found.still) == (4, (name,))
    assert str(found) == f"4 of 6; {name} has speed 0"


def test_robots_that_hardly_differ_are_reached_barely():
    assert reach(of(a=(6, 6.06, 3))).barely > 0


def test_the_spread_grows_with_the_difference_and_not_with_rare_sequences():
    """Regression: it was the root of what a few sequences of a thousand contribute, which near an
    unstable direction part even robots that hardly differ."""
    one, two = (reach(of(a=(6, 6 * (1 + by), 3))).spread[-1] for by in (0.002, 0.004))
    assert 1.7 < two / one < 2.3


@pytest.mark.parametrize("motion", ["exact", "euler", "arc"])
def test_any_motion_has_a_verdict(motion):
    pso = {"type": "pso-mpc", "motion": motion}
    assert (reach(of(controller=pso)).rank, reach(of((6, 6, 3), controller=pso)).rank) == (6, 4)


def test_of_very_many_robots_nothing_is_said():
    one = THREE_M3PI["robots"][0]
    robots = [one | {"name": f"r{i}", "start": [100.0 + i, 100.0]} for i in range(ROBOTS_MAX + 1)]
    assert reach(experiment(robots=robots)) is None


@pytest.mark.slow
def test_analyze_says_it_where_no_plan_is_found():
    mpc = {"type": "mpc", "period": 0.2, "horizon_max": 12, "estimate": False}
    found = analyze(of(a=(6, 6, 3), controller=mpc), plans=1)
    assert found.steering is None
    assert ("reach of the signal", str(found.reach)) in list(tables(found)[0].rows)
    assert as_json(found)["reach"]["rank"] == 4
