"""A process that compiles the kernels and one that loads them compute the same bits."""

import os
import subprocess
import sys

import pytest
from support.paths import ROOT

SEARCH = """
import hashlib, sys
from pathlib import Path
from tetractl.control.kernels.levenberg import polish
from tetractl.control.optimizers.multistart import Multistart
from tetractl.control.optimizers.pso import Pso
from tetractl.core.plan import Limits
from tetractl.experiment.load import load_spec

digest = hashlib.sha256()
for name in ("three_m3pi", "three_m3pi_paper"):
    experiment = load_spec(Path(sys.argv[1]) / f"{name}.yaml").experiment
    problem = experiment.controller.problem(experiment.setup)
    for optimizer in (Multistart(rounds=2), Pso(iterations=20)):
        search = optimizer.search(problem, 30, None, 1, Limits())
        digest.update(search.signals.tobytes() + search.history.tobytes())
print(sum(polish.stats.cache_hits.values()), digest.hexdigest())
"""


@pytest.mark.slow
def test_compiling_and_loading_give_the_same_bits(tmp_path):
    """Regression: a callee that was not inlined had two machine codes, one for each."""
    experiments = ROOT / "experiments"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", SEARCH, str(experiments)]
    found = [
        subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    ]
    assert [hits for hits, _ in found] == ["0", "2"]  # a kernel for each motion
    assert found[0][1] == found[1][1]
