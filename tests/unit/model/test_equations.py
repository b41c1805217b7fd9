"""Tests that each of the paper's equations has one function, and that motion has one place."""

import inspect
import re
from pathlib import Path

import pytest

import tetractl
from tetractl.control.search import cost, stop
from tetractl.control.search.kernels import update
from tetractl.model import wheels
from tetractl.model.motion import euler, exact, wheel_equations

EQUATIONS = {
    "(1)": exact.rates,
    "(3)": exact.rates,
    "(4)": euler.step,
    "(6)": euler.step,
    "(7)": cost.costs_along,
    "(8)": cost.costs_along,
    "(9)": cost.costs_along,
    "(14)-(17)": update.move.py_func,
    "(20)": stop,
    "(21)": wheels.compute_body_velocity,
    "(21)-(23)": wheel_equations.arc_displacement,
    "(24)-(25)": wheel_equations.wheel_speeds,
}
MOTIONS = {"euler.py", "exact.py", "turn_rate.py"}
TURN = re.compile(
    r"\ba \* (np|math)\.sin\("
    r"|su \* c - cu \* s"
    r"|direction_sin \* heading_cos - direction_cos \* heading_sin"
)


@pytest.mark.parametrize("equation", EQUATIONS)
def test_the_function_of_an_equation_names_it(equation):
    assert equation in inspect.getsource(EQUATIONS[equation])


def test_how_a_robot_turns_towards_u_stands_in_the_files_of_motions_alone():
    root = Path(tetractl.__file__).parent
    files = [*root.rglob("*.py"), *(root.parent / "packages").rglob("tetractl_*/**/*.py")]
    assert {file.name for file in files if TURN.search(file.read_text())} == MOTIONS
