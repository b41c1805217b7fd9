"""Tests of a motion and a shape from docs/how-to/extend.md, which tetractl itself does not know.

Planner, compiled kernels, polish, plant, checks, log and images must all use them.
"""

import json
import re

import pytest
from testkit.packages import install, python
from testkit.paths import ROOT

pytestmark = pytest.mark.system

POINTS = """[tetractl.motions]
pivot = pivot:PIVOT
[tetractl.shapes]
diamond = diamond:Diamond
"""
PLAN = """
import json, sys
from pathlib import Path
import numpy as np
from tetractl.control.search.cost import evaluate, predict
from tetractl.control.search.evaluate import compiled_costs
from tetractl.control.search.kernels.levenberg import PolishSettings, workspace_for
from tetractl.control.search.kernels.motion import flatten
from tetractl.control.search.kernels.multistart import (
    POLISH,
    UNLIMITED,
    SearchTask,
    rounds_for,
    search,
)
from tetractl.control.search.kernels.rollout import rollouts_of
from tetractl.core.plan import Limits
from tetractl.spec.load import load_spec

spec = load_spec(Path("s.yaml")).experiment
problem = spec.controller.problem(spec.setup)
signals = np.random.default_rng(1).uniform(-0.4, 0.4, (200, 24))
reference = evaluate(problem, signals)
compiled = compiled_costs(problem, 200)(np.ascontiguousarray(signals.T))
start = np.zeros(24)
found = rounds_for(0, 1, 1, 1, 24, 5, 0)
found.begin(POLISH, start[None])
rooms = rollouts_of(0, 1, 1), workspace_for(problem, 24)
settings = PolishSettings(1e-3, 0.5, 6, 5)
key, warm, rounds = np.uint64(0), np.empty(0), 0
task = SearchTask(flatten(problem), *rooms, settings, key, warm, rounds, UNLIMITED)
search(task, found, UNLIMITED)
z = int(found.polish.iterations)
best = spec.controller.optimizer.search(problem, 24, None, 1, Limits())
x, y = predict(problem, best.signals)[..., :2].T
print(json.dumps({
    "hits": int((reference.obstacle > 0).sum()),
    "worst": float(np.abs(compiled / reference.total - 1).max()),
    "polish": float(found.merits[z] / found.merits[0]),
    "straight": float(evaluate(problem, start[None]).obstacle[0]),
    "found": float(evaluate(problem, best.signals[None]).obstacle[0]),
    "clear": float(spec.obstacles[0].shape().distance(x, y).min()),
    "cost": best.cost,
}))
"""
SPEC = """
name: beyond
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots: [{name: a, start: [150, 500], target: [850, 500], a: 6, speed: 180}]
obstacles: [{type: diamond, center: [500, 510], radius: 120}]
controller:
  type: mpc
  period: 0.2
  motion: pivot
  horizon_max: 30
  estimate: false
  collision: {margin: 10}
  optimizer: {type: multistart, tolerance: 0.1}
plant: {type: sim, motion: pivot}
trials: {count: 1}
"""


def code(name):
    page = (ROOT / "docs" / "how-to" / "extend.md").read_text(encoding="utf-8")
    block = re.search(rf"```python title={name}\.py\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    return block[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder with the spec, and how to run something there with the package installed."""
    tmp_path = tmp_path_factory.mktemp("models")
    site = install(
        tmp_path / "site", "mine", "1.0", POINTS, pivot=code("pivot"), diamond=code("diamond")
    )
    (tmp_path / "s.yaml").write_text(SPEC, encoding="utf-8")
    sites = [site, ROOT, ROOT / "tests"]

    def run(*words):
        return python(tmp_path, sites, *words, COLUMNS="80")

    return tmp_path, run


def test_planner_kernels_and_polish_honour_them(installed):
    _, run = installed
    done = run("-c", PLAN)
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout)
    assert printed["hits"] > 20
    assert printed["worst"] < 1e-9
    assert printed["polish"] < 0.1
    assert printed["straight"] > 0  # straight on is through the diamond ...
    assert printed["found"] == 0  # ... and the polish leads out of it
    assert printed["clear"] > 9.9
    assert printed["cost"] <= 0.1
