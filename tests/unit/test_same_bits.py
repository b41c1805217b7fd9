"""Tests that simulated trials call no function whose bits depend on the processor."""

import ast

import pytest
from testkit.paths import ROOT

from tetractl.log.provenance import TRIAL_CODE_PARTS

PACKAGE = ROOT / "tetractl"
FILES = sorted(file for part in TRIAL_CODE_PARTS for file in (PACKAGE / part).rglob("*.py"))
LIBRARIES = ("math", "cmath", "np", "numpy")
TRIGONOMETRIC = (
    "sin cos tan asin acos atan atan2 arcsin arccos arctan arctan2 sinc angle phase rect"
)
HYPERBOLIC = "sinh cosh tanh asinh acosh atanh arcsinh arccosh arctanh"
EXPONENTIAL = "exp exp2 expm1 log log2 log10 log1p logaddexp pow power float_power cbrt geomspace"
OTHER = "hypot dist erf erfc gamma lgamma polynomial fft convolve correlate"
LINEAR = "dot vdot inner matmul tensordot cov corrcoef polyfit linalg"
DRAWN = frozenset(["lognormal", "vonmises", "multivariate_normal"])
FUNCTIONS = DRAWN.union(*map(str.split, (TRIGONOMETRIC, HYPERBOLIC, EXPONENTIAL, OTHER, LINEAR)))
"""Functions of the C library, of NumPy's own code for each processor, and of BLAS."""
ALLOWED = {
    "tools/likelihood.py": "fits recordings, for packages: no part of a trial",
    "tools/table/table.py": "rounds what a table prints",
}


def calls(file):
    """Yield line and name of what depends on the processor."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Attribute) and node.attr in FUNCTIONS:
            owner = node.value
            if isinstance(owner, ast.Name) and owner.id in LIBRARIES:
                yield node.lineno, f"{owner.id}.{node.attr}"
            elif node.attr in DRAWN:
                yield node.lineno, node.attr
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            yield node.lineno, "@"
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            if not isinstance(node.left, ast.Constant):
                yield node.lineno, "**"
        elif isinstance(node, ast.ImportFrom) and node.module in LIBRARIES:
            yield from ((node.lineno, n.name) for n in node.names if n.name in FUNCTIONS)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_trials_follow_from_functions_with_the_same_bits_everywhere(file):
    """Call `tetractl.core.elementary`, `elementwise`, np.square, np.einsum instead."""
    if str(file.relative_to(PACKAGE)) in ALLOWED:
        return
    assert [f"line {line}: {name}" for line, name in calls(file)] == []


def test_the_check_finds_such_calls(tmp_path):
    source = "y = np.tanh(x) + math.sin(x) + a @ b + x**2 + rng.lognormal(1) + np.linalg.inv(a)\n"
    (tmp_path / "module.py").write_text(
        source + "from math import exp\nz = 2.0**-53 + np.sqrt(x)\n"
    )
    found = [name for _, name in calls(tmp_path / "module.py")]
    assert sorted(found) == ["**", "@", "exp", "lognormal", "math.sin", "np.linalg", "np.tanh"]
