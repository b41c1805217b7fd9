import subprocess
import sys
from types import SimpleNamespace

import pytest
from numba import njit
from testkit.running import QUICK

from tetractl.control.methods import build
from tetractl.spec.load import parse_spec

pytestmark = pytest.mark.slow

WATCH = """
from pathlib import Path
import numpy as np
from numba.core.dispatcher import Dispatcher
from tetractl.control.methods.build import warm_up
from tetractl.run.checked_controller import build_controller
from tetractl.core.commands import Command
from tetractl.core.plan import Plan
from tetractl.core.poses import Observation, Poses
from tetractl.spec.load import load_spec

small = ["controller.horizon_max=4"]
spec = load_spec(Path("experiments/{name}.yaml"), small).experiment
warm_up(spec, print)
late, compile = [], Dispatcher.compile
Dispatcher.compile = lambda self, types: late.append(self.py_func.__name__) or compile(self, types)
poses = np.array([[*robot.start, robot.heading] for robot in spec.robots])
controller = build_controller(spec, 1)
command = None
for k in range(4):
    ns = 200_000_000 * k
    seen = Observation(24 * k, ns, ns, Poses.from_array(poses), np.ones(len(spec.robots), bool))
    plan = controller.plan(seen, command)
    assert isinstance(plan, Plan)
    command = Command(plan.action, ns, (True,) * len(spec.robots))
    poses = plan.path[1]
print(late)
"""


@pytest.mark.long
@pytest.mark.parametrize("name", ["three_m3pi", "three_m3pi_paper"])
def test_warming_up_leaves_nothing_to_compile(name):
    done = subprocess.run(
        [sys.executable, "-c", WATCH.replace("{name}", name)], capture_output=True, text=True
    )
    assert done.stdout.splitlines()[-1:] == ["[]"], done.stdout + done.stderr


@pytest.mark.parametrize("again_s", [0.0, 3600.0])
def test_only_compiling_is_announced_with_for_what_and_how_long_it_takes(monkeypatch, again_s):
    monkeypatch.setattr(build, "REMINDER_S", again_s)
    monkeypatch.setattr(build, "time", SimpleNamespace(monotonic=lambda: 7.0))
    spec = parse_spec(QUICK, "spec").experiment
    said = []

    class New:
        """Stands for a section whose kernels are in the cache, but for two functions."""

        type = "mpc"
        motion = "exact"
        optimizer = spec.controller.optimizer

        def warm_up(self, setup):
            spec.controller.warm_up(spec.setup)  # from the cache, however long that takes
            assert said == []
            njit(lambda x: 2 * x)(21)  # kept in no cache
            njit(lambda x: 3 * x)(14)

    build.warm_up(spec, lambda text: None)
    build.warm_up(SimpleNamespace(controller=New(), obstacles=(), setup=None), said.append)
    first = (
        "compiling for mpc, pso, exact: this takes about a minute, longer if the computer is busy; "
        "later runs reuse the compiled code ..."
    )
    again = ["compiling for mpc, pso, exact: 0 s so far ..."] if again_s == 0 else []
    assert said == [first, *again, "compiled in 0 s"]
