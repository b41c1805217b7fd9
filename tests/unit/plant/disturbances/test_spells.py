"""Tests of the intervals in which disturbances act."""

import numpy as np
import pytest
from pydantic import ValidationError

from tetractl.plant.disturbances.radio import SilentRadioSection
from tetractl.plant.disturbances.spells import AlternatingStates


def section(**fields):
    """Any section with intervals."""
    return SilentRadioSection.model_validate({"type": "silent-radio", "duration": 0.5} | fields)


def test_an_interval_contains_its_start_but_not_its_end():
    spells = section(between=[2.0, 2.0]).draw(np.random.default_rng(1))
    at = [1.9999, 2.0, 2.25, 2.4999, 2.5, 3.0]
    assert [spells.include(time_s) for time_s in at] == [False, True, True, True, False, False]


def test_intervals_begin_within_the_limits_and_differ_from_trial_to_trial():
    begins = []
    for seed in range(60):
        spells = section(between=[1.0, 3.0], duration=10.0).draw(np.random.default_rng(seed))
        times_s = np.linspace(0, 4, 101)
        active = [spells.include(time_s) for time_s in times_s]
        begins.append(times_s[active.index(True)])
    assert min(begins) == pytest.approx(1.0, abs=0.15)
    assert max(begins) == pytest.approx(3.0, abs=0.15)
    assert np.mean(begins) == pytest.approx(2.0, abs=0.2)


def test_any_of_several_intervals_is_enough_and_none_means_never():
    rng = np.random.default_rng(3)
    many = section(times=40, between=[0.0, 4.0]).draw(rng)
    assert all(many.include(time_s) for time_s in np.linspace(0.5, 4.0, 50))
    none = section(times=0, between=[0.0, 4.0]).draw(rng)
    assert not any(none.include(time_s) for time_s in np.linspace(0, 5, 50))


@pytest.mark.parametrize("fields", [{"duration": 0}, {"times": -1}, {"between": [-1.0, 2.0]}])
def test_an_interval_that_cannot_be_is_refused(fields):
    with pytest.raises(ValidationError):
        section(**fields)


def test_robots_alternate_one_by_one_beginning_undisturbed():
    well_s = iter([1.0, 2.0, 0.5, 100.0])
    unwell_s = iter([0.25, 3.0])
    robots = AlternatingStates(2, lambda: next(well_s), lambda: next(unwell_s))
    seen = {at: robots.advance(at).tolist() for at in (0, 0.999, 1.0, 1.249, 1.25, 1.749)}
    assert seen == {
        0: [True, True],
        0.999: [True, True],
        1.0: [False, True],
        1.249: [False, True],
        1.25: [True, True],
        1.749: [True, True],
    }
    assert robots.advance(1.75).tolist() == [False, True]


def test_a_robot_that_was_not_looked_at_for_long_has_changed_in_between():
    robots = AlternatingStates(
        1, lambda: 1.0, lambda: 0.5
    )  # undisturbed from 0 to 1, 1.5 to 2.5, ...
    assert [robots.advance(at).item() for at in (0.9, 4.4, 4.6, 9.2)] == [True, False, True, True]
