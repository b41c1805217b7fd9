"""Tests of ranking choices of cells by their predicted errors."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.paths import EXAMPLES
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.choosing import choose_cells
from tetractl_microscope.choice.closed_loop import Noise
from tetractl_microscope.choice.ranked import RankedChoice, rank_choices

from tetractl.core.poses import Pose
from tetractl.spec.load import load_spec

pytestmark = pytest.mark.slow


def test_where_no_choice_of_cells_has_a_plan_the_ranking_ends_with_its_first_round():
    spec = load_spec(EXAMPLES / "tetrahymena_dish.yaml", ["controller.horizon_max=3"])
    cells = [
        RobotCandidate(
            i, Pose(1000 + 300 * i, 900, 0.0), a=3.0 + i, a_sd=0.1, speed=400, speed_sd=4
        )
        for i in range(4)
    ]
    counted = []
    choices = rank_choices(
        spec.experiment,
        cells,
        Noise.from_plant(spec.experiment.plant),
        12,
        lambda *n: counted.append(n),
    )
    assert not np.isfinite([choice.error for choice in choices]).any()
    assert len(counted) == 4  # one prediction for each three of four cells


def found_cell(number, a):
    return RobotCandidate(number, Pose(1000 + 300 * number, 900, 0.0), a, 0.1, 400, 4)


def test_the_cells_of_a_trial_are_those_that_differ_most():
    spec = load_spec(EXAMPLES / "tetrahymena_dish.yaml", ["robots.choose=2"])
    cells = [found_cell(i, a) for i, a in enumerate((4.0, 4.2, 5.5))]
    assert [cell.number for cell in choose_cells(spec.experiment, cells)] == [2, 0]


@pytest.mark.long
def test_a_choice_with_a_cell_near_the_edge_comes_last():
    """Regression: `lab survey` preferred a cell that it called unreliable."""
    spec = load_spec(EXAMPLES / "tetrahymena_dish.yaml", ["robots.choose=2"])
    noise = Noise.from_plant(spec.experiment.plant)
    cells = [found_cell(i, a) for i, a in enumerate((3.0, 4.0, 5.5))]
    best = rank_choices(spec.experiment, cells, noise, 12)[0]
    near = best.cells[0].number
    uncertain = [replace(cell, free=cell.number != near) for cell in cells]
    first, *others = rank_choices(spec.experiment, uncertain, noise, 12)
    assert near not in first.numbers
    assert np.isfinite(first.error)
    assert all(near in choice.numbers for choice in others)


@pytest.mark.long
def test_no_choice_has_cells_that_cannot_be_distinguished():
    spec = load_spec(EXAMPLES / "tetrahymena_dish.yaml", ["robots.choose=2"])
    cells = [found_cell(i, a) for i, a in enumerate((4.0, 4.2, 5.5))]
    noise = Noise.from_plant(spec.experiment.plant)
    chosen = {
        frozenset(choice.numbers) for choice in rank_choices(spec.experiment, cells, noise, 12)
    }
    assert chosen == {frozenset((0, 2)), frozenset((1, 2))}
    assert rank_choices(spec.experiment, cells[:2], noise, 12) == []


def test_a_choice_is_predicted_along_the_same_plans_however_many_rounds_there_are():
    spec = load_spec(EXAMPLES / "tetrahymena_dish.yaml", ["robots.choose=2"])
    cells = [found_cell(i, a) for i, a in enumerate((4.5, 3.0))]
    noise = Noise.from_plant(spec.experiment.plant)
    (choice,) = rank_choices(spec.experiment, cells, noise, 12)
    at_once = RankedChoice(spec.experiment, choice.cells, noise).along(12)
    assert choice.error == at_once.error


def test_what_does_not_swim_does_not_respond_to_the_field():
    """Regression: a speck of which an axis was seen, at 8 um/s, was chosen, and steered for 6 s."""
    speck = replace(found_cell(1, 6.04), a_sd=1.71, speed=7.9, speed_sd=5.2)
    assert not speck.magnetised
    assert replace(speck, speed=79.0).magnetised
