"""What is sampled for a fault: within its limits, growing with its strength, in both directions."""

import math
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.emulator.device_specs import FIELD_SPEC
from testkit.lab_specs import SPEC
from tetractl_emulator import fault_rows
from tetractl_emulator.fault_rows import ENDLESS_STRENGTH, FRAME_S, RandomChoices
from tetractl_emulator.optitrack.scripted import FAULTS

from tetractl.spec.load import parse_spec

strengths = st.floats(0, 1, exclude_max=True)
seeds = st.integers(0, 10**6)
LOW, HIGH = 2.0, 50.0


def draw(strength=0.5, seed=1, scale=1.0):
    return RandomChoices(Random(seed), ["green", "blue"], strength, scale)


def size_at(strength):
    """The size of which the logarithm grows evenly with the strength."""
    return math.exp((1 - strength) * math.log(LOW) + strength * math.log(HIGH))


@given(strengths, seeds)
def test_sizes_grow_with_the_strength_from_the_least_to_the_most(strength, seed):
    expected = pytest.approx(size_at(strength), rel=1e-3)
    assert fault_rows.value_between(LOW, HIGH)(draw(strength, seed)) == expected
    assert abs(fault_rows.signed_value(LOW, HIGH)(draw(strength, seed))) == expected
    assert abs(fault_rows.factor_near_one(LOW, HIGH)(draw(strength, seed)) - 1) == expected
    assert math.hypot(*fault_rows.random_vector(LOW, HIGH)(draw(strength, seed))) == expected
    whole = fault_rows.whole_number(LOW, HIGH)(draw(strength, seed))
    assert isinstance(whole, int)
    assert whole == pytest.approx(size_at(strength), abs=0.51)
    assert fault_rows.two_whole_numbers(fault_rows.value_between(LOW, HIGH))(
        draw(strength, seed)
    ) == [
        whole,
        whole,
    ]


@given(strengths, seeds)
def test_lengths_and_changes_of_a_frame_are_scaled(strength, seed):
    length = math.hypot(*fault_rows.scaled_vector(LOW, HIGH)(draw(strength, seed, 0.1)))
    assert length == pytest.approx(0.1 * size_at(strength), rel=1e-3)
    length = math.hypot(*fault_rows.scaled_vector(LOW, HIGH, FRAME_S)(draw(strength, seed, 0.1)))
    assert length == pytest.approx(0.1 * FRAME_S * size_at(strength), rel=1e-2)
    change = abs(fault_rows.signed_value(LOW, HIGH, FRAME_S)(draw(strength, seed)))
    assert change == pytest.approx(FRAME_S * size_at(strength), rel=1e-3)
    change = abs(fault_rows.factor_near_one(LOW, HIGH, FRAME_S)(draw(strength, seed)) - 1)
    assert change == pytest.approx(FRAME_S * size_at(strength), rel=1e-3)


@given(strengths, seeds, st.floats(-3, 3))
def test_a_motion_along_a_line_goes_forwards_or_backwards_on_it(strength, seed, angle):
    x, y = fault_rows.along_line(LOW, HIGH, angle)(draw(strength, seed, 2.0))
    assert math.hypot(x, y) == pytest.approx(2.0 * FRAME_S * size_at(strength), rel=1e-3)
    assert x * math.sin(angle) - y * math.cos(angle) == pytest.approx(0, abs=1e-5)


def test_both_signs_and_all_directions_occur():
    """Of 200 draws; that one in four quadrants is left out has the probability 4e-25."""
    each = range(200)
    assert {fault_rows.signed_value(1, 2)(draw(seed=seed)) > 0 for seed in each} == {True, False}
    assert {fault_rows.factor_near_one(0.1, 0.2)(draw(seed=seed)) > 1 for seed in each} == {
        True,
        False,
    }
    assert {fault_rows.along_line(1, 2, 0.0)(draw(seed=seed))[0] > 0 for seed in each} == {
        True,
        False,
    }
    vectors = [fault_rows.random_vector(1, 2)(draw(seed=seed)) for seed in each]
    assert len({(x > 0, y > 0) for x, y in vectors}) == 4
    values = {fault_rows.one_of(1, "a", None)(draw(seed=seed)) for seed in each}
    assert values == {1, "a", None}


@given(strengths)
def test_parts_are_at_most_1_and_what_remains_at_least_its_least(strength):
    assert fault_rows.fraction_between(0.5, 3.0)(draw(strength)) <= 1
    assert fault_rows.fraction_between(0.1, 0.5)(draw(strength)) == pytest.approx(
        0.1 * 5**strength, rel=1e-3
    )
    assert fault_rows.one_minus(0.1, 0.5)(draw(strength)) == pytest.approx(
        1 - 0.1 * 5**strength, abs=2e-4
    )
    assert fault_rows.one_minus(0.5, 2.0, 0.2)(draw(strength)) >= 0.2


def test_lost_messages_are_few_many_or_all():
    assert fault_rows.lost_fraction(draw(0.0)) == pytest.approx(0.05, abs=0.003)
    assert fault_rows.lost_fraction(draw(ENDLESS_STRENGTH * 0.999999)) == pytest.approx(
        0.98, abs=0.003
    )
    assert fault_rows.lost_fraction(draw(ENDLESS_STRENGTH)) == 1.0
    assert fault_rows.lost_fraction(draw(0.99)) == 1.0
    shares = [fault_rows.lost_fraction(draw(step / 100)) for step in range(100)]
    assert shares == sorted(shares)


def test_the_fault_is_of_the_first_robot_and_the_other_is_another():
    assert fault_rows.NAME_FUNCTIONS["robot"](draw()) == "green"
    assert fault_rows.NAME_FUNCTIONS["other"](draw()) == "blue"


def test_lengths_are_scaled_by_the_fastest_cell_and_not_for_robots_on_wheels():
    cells = parse_spec(FIELD_SPEC, "lab.yaml").experiment
    assert fault_rows.length_scale(cells.lab, cells.setup) == pytest.approx(200 / 200)  # mm/s, blue
    text = FIELD_SPEC.replace("speed: 180", "speed: 0.5").replace("speed: 200", "speed: 0.4")
    slow = parse_spec(text, "lab.yaml").experiment
    assert fault_rows.length_scale(slow.lab, slow.setup) == pytest.approx(0.5 / 200)
    in_um = parse_spec(text.replace("length: mm", "length: um"), "lab.yaml").experiment
    assert fault_rows.length_scale(in_um.lab, in_um.setup) == pytest.approx(0.0005 / 200)
    wheels = parse_spec(SPEC.replace("speed: 200", "speed: 90"), "lab.yaml").experiment
    assert fault_rows.length_scale(wheels.lab, wheels.setup) == 1.0


@pytest.mark.parametrize(("name", "sideways"), [("ghost drives", False), ("ghost slides", True)])
def test_a_ghost_drives_along_its_heading_or_slides_across_it(name, sideways):
    rows = {row.name: row for kind in FAULTS for row in kind.rows}
    for seed in range(20):
        ahead, aside = rows[name].fields["by"](draw(0.8, seed))
        assert rows[name].fields["axes"] == "robot"
        assert abs(ahead if sideways else aside) < 1e-6
        assert abs(aside if sideways else ahead) > 0.1
