"""benchmarks/solver.py prints every row, with the peers that are installed."""

import importlib.util
import subprocess
import sys

from support.paths import ROOT

SCRIPT = ROOT / "benchmarks" / "solver.py"
ROWS = {  # one of each part
    "our readable NumPy reference",
    "**ours (multistart)**",
    "exact, swept, walls",
    "particles",
    "Euler rollout and obstacle, our kernel",
    "**ours, compensated and estimated**",
}
PEERS = {
    "pyswarms": ["pyswarms, J in plain NumPy", "pyswarms, J in tuned NumPy", "pyswarms"],
    "cma": ["pycma"],
    "tetractl_ipopt": ["CasADi + IPOPT", "CasADi + IPOPT, 44 signals, warm-started"],
}


def run(*args, cwd):
    return subprocess.run(
        [sys.executable, SCRIPT, *args], cwd=cwd, capture_output=True, text=True, timeout=900
    )


def test_the_quick_run_prints_every_row_and_every_bar(tmp_path):
    done = run("--quick", "--plot", "growth.svg", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    firsts = [line.split("|")[1].strip() for line in done.stdout.splitlines() if "|" in line]
    assert set(firsts) >= ROWS
    for module, rows in PEERS.items():
        if importlib.util.find_spec(module):
            assert set(rows) <= set(firsts)
        else:
            assert not set(rows) & set(firsts)
            assert f"{module} not installed" in done.stdout
    for bar in ("NumPy reference", "3 lengths x 100 iterations", "step-0 sweep", "solved to 1 mm"):
        assert any(bar in first for first in firsts)
    assert sum(first.startswith("growth with") for first in firsts) == 3
    assert (tmp_path / "growth.svg").stat().st_size > 5000


def test_an_unknown_part_is_a_usage_error(tmp_path):
    done = run("--only", "x", cwd=tmp_path)
    assert done.returncode == 2
    assert "no part x" in done.stderr
