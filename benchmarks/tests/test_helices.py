"""Two helices steered by direction and frequency, against the closed form."""

import numpy as np
import pytest
from helices import WORLDS, along_axes, drive, main

GOALS = np.array([[120.0, -40.0], [30.0, 90.0]])


@pytest.mark.parametrize(("world", "most"), [*zip(WORLDS, (1.0001, 1.5, 1.15), strict=True)])
def test_goals_are_reached_in_about_the_least_time(world, most):
    ratio, far, late = drive(GOALS, np.random.default_rng(1), WORLDS[world])
    assert 0.9 < ratio < most
    assert far < 10
    assert not late


def test_the_plan_along_two_axes_is_never_faster():
    goals = np.random.default_rng(2).normal(0, 300, (10, 2, 2))
    assert all(1 <= along_axes(one) < np.sqrt(2) for one in goals)


def test_the_table_ends_with_why_equal_step_outs_are_refused(capsys):
    main(2, 1)
    assert "move alike at every frequency" in capsys.readouterr().out.splitlines()[-1]
