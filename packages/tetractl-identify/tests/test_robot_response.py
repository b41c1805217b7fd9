"""Tests of the table of robots' responses to speeds, and of the notes below it."""

from dataclasses import replace

import pytest
from tetractl_identify.explained import Explained
from tetractl_identify.robot_response import UNITS, RobotResponse, create_response_table

from tetractl.tools.likelihood import SampleInterval

FOLLOWED = Explained(0.98, unexplained_sum=0.1, asked_sum=9.0)


def interval(value, reach=0.01):
    return SampleInterval(value, value - reach, value + reach)


GOOD = RobotResponse(
    name="one",
    dead_time=interval(0.1),
    turning_lag=interval(0.08),
    speed_lag=interval(0.15),
    turning_gain=interval(0.95),
    speed_gain=interval(1.05),
    veer=interval(0.0004),
    heading_offset=interval(0.01),
    heading_walk=interval(0.02),
    heading_noise=interval(0.003, 0.001),
    way_walk=interval(2.0),
    position_noise=interval(0.3),
    clock_drift=None,
    turning_explained=FOLLOWED,
    distance_explained=FOLLOWED,
    duration_s=30.0,
    intervals=290,
    left_out=10,
)


def table(*responses):
    return create_response_table(responses, "a title", "mm")


def notes(*responses):
    return table(*responses).note.splitlines()


def test_a_row_for_each_value_and_three_more():
    quantity, one = table(GOOD).columns
    assert (quantity.name, one.name) == ("quantity", "one")
    assert quantity.values == [
        "dead time [s]",
        "turning lag [s]",
        "speed lag [s]",
        "turning gain",
        "speed gain",
        "veer [rad/mm]",
        "heading offset [rad]",
        "heading walk [rad/sqrt(s)]",
        "heading noise [rad]",
        "way walk [mm/sqrt(s)]",
        "position noise [mm]",
        "turning explained",
        "distance explained",
        "left out",
    ]
    assert one.values[0] == "0.100 (0.090 to 0.110)"
    assert one.values[3:5] == ["0.950 (0.940 to 0.960)", "1.050 (1.040 to 1.060)"]
    assert one.values[-3:] == ["98%", "98%", "10 of 300"]
    assert len(one.values) == len(quantity.values)


def test_the_drift_of_the_clocks_has_a_row_if_there_are_two():
    drifting = replace(GOOD, clock_drift=interval(1e-3, 1e-4))
    assert list(GOOD.quantities) == [name for name in UNITS if name != "clock_drift"]
    assert list(drifting.quantities) == list(UNITS)
    quantity, _ = table(drifting).columns
    assert "clock drift [s/s]" in quantity.values


@pytest.mark.parametrize(("drift", "is_named"), [(0.0030, False), (0.0036, True), (-0.0036, True)])
def test_a_drift_is_named_if_the_clocks_are_a_tenth_of_a_second_apart_at_the_end(drift, is_named):
    """0.1 s in the 30 s of the longest recording."""
    drifting = replace(GOOD, clock_drift=interval(drift, 1e-4))
    shorter = replace(drifting, name="two", duration_s=5.0)
    for responses in ([drifting], [shorter, drifting]):
        assert ("clock drift of one" in table(*responses).note) == is_named


def test_a_response_as_usual_has_only_the_note_of_its_lag():
    (note,) = notes(GOOD)
    assert note == "lag of turning, to put into a spec: lab.lag=0.080 (simulated: wheels.lag)"


@pytest.mark.parametrize("reach", [0.019, 0.021])
def test_a_lag_that_is_hardly_known_is_not_recommended(reach):
    named = notes(replace(GOOD, turning_lag=interval(0.08, reach)))
    assert bool(named) == (reach < 0.02)
    both = notes(GOOD, replace(GOOD, name="two", turning_lag=interval(0.08, reach)))
    assert bool(both) == (reach < 0.02)


def test_the_recommended_lag_is_a_mean_in_which_precise_lags_count_more():
    precise = replace(GOOD, turning_lag=interval(0.07, 0.002))
    coarse = replace(GOOD, name="two", turning_lag=interval(0.09, 0.006))
    (note,) = notes(precise, coarse)
    assert "lab.lag=0.075 " in note  # three to one
    (note,) = notes(coarse, precise)
    assert "lab.lag=0.075 " in note


@pytest.mark.parametrize(("apart", "are_same"), [(0.039, True), (0.041, False)])
def test_lags_that_differ_too_much_have_no_common_value(apart, are_same):
    other = replace(GOOD, name="two", turning_lag=interval(0.08 + apart))
    (note,) = notes(GOOD, other)
    assert note.startswith("lag of turning") == are_same
    assert ("differ by more than 0.02 s" in note) != are_same


@pytest.mark.parametrize(
    "name", ["dead_time", "turning_lag", "speed_lag", "turning_gain", "speed_gain", "veer"]
)
def test_a_value_that_the_data_do_not_determine_is_named(name):
    unknown = SampleInterval(getattr(GOOD, name).value, 0.0, float("inf"))
    note = table(replace(GOOD, **{name: unknown})).note
    assert f"do not determine {name.replace('_', ' ')} of one" in note


@pytest.mark.parametrize("name", ["heading_walk", "way_walk", "position_noise", "heading_noise"])
def test_noise_that_the_data_do_not_determine_is_not_named(name):
    unknown = SampleInterval(getattr(GOOD, name).value, 0.0, float("inf"))
    assert "determine" not in table(replace(GOOD, **{name: unknown})).note


def test_unusual_values_are_named_with_their_robot():
    note = table(GOOD, replace(GOOD, name="two", turning_gain=interval(0.3))).note
    assert "the turning gain of two is 0.3 (usual: 0.5 to 2)" in note
    assert "of one is" not in note


WORSE = Explained(0.3, unexplained_sum=4.0, asked_sum=9.0)
HARDLY_ASKED = Explained(0.3, unexplained_sum=4.0, asked_sum=1.0)


def test_commands_that_explain_little_of_a_motion_are_a_problem_of_this_motion():
    assert GOOD.problem == ""
    assert replace(GOOD, turning_explained=WORSE).problem == "30% of the turning"
    assert replace(GOOD, distance_explained=WORSE).problem == "30% of the distance travelled"
    both = replace(GOOD, turning_explained=WORSE, distance_explained=WORSE)
    assert both.problem == "30% of the turning and 30% of the distance travelled"


def test_a_robot_that_is_hardly_asked_to_move_is_a_problem_only_if_its_gain_is_unusual():
    for explained, gain, said in (
        ("turning_explained", "turning_gain", "turning"),
        ("distance_explained", "speed_gain", "distance travelled"),
    ):
        hardly = replace(GOOD, **{explained: HARDLY_ASKED})
        assert hardly.problem == ""
        assert replace(hardly, **{gain: interval(-0.5)}).problem == f"30% of the {said}"
        assert replace(hardly, **{gain: interval(-0.5, 1.5)}).problem == ""
