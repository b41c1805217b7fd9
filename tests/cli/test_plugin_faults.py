"""Tests that an exception in a trial with plug-ins gives one line that names them."""

import pytest
from testkit.cli import process
from testkit.packages import install

pytestmark = pytest.mark.system

SPEC = """
name: one
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots: [{name: a, start: [200, 500], target: [500, 500], a: 6, speed: 100}]
controller: {type: east, time_limit: 4.2}
trials: {count: 1}
"""
POINTS = """
[tetractl.controllers]
east = east:East
[tetractl.disturbances]
anchor = anchor:Anchor
"""
EAST = """
import time
from typing import Literal
import numpy as np
from tetractl.core.plan import Outcome, Plan, Search, StopReason
from tetractl.spec.controller import ALONE, ControllerSection

class East(ControllerSection):
    type: Literal["east"]
    fails_at: int = 99
    ends: str = "no"
    steps: int = 20
    def build(self, setup, key, host=ALONE):
        return Driver(self)

class Driver:
    def __init__(self, section):
        self.section, self.k = section, -1
    def plan(self, observation, last_command=None, earlier=()):
        self.k += 1
        if self.k > self.section.steps:
            return Outcome.TIME_LIMIT
        1 / (self.section.fails_at - self.k)
        cost, signals = 1.0, np.zeros(1)
        if self.k == 3 and self.section.ends == "exit":
            raise SystemExit(0)
        if self.k == 3 and self.section.ends == "nan":
            cost = np.nan
        search = Search(1, signals, cost, np.array([cost]), 1, StopReason.CRITERION)
        path = np.stack([observation.poses.array()] * 2)
        return Plan(signals, path, cost, cost, 0.0, (search,), 0, 0)
"""
ANCHOR = """
from typing import Literal
import numpy as np
from tetractl.spec.disturbance import Disturbance, DisturbanceSection

class Anchor(DisturbanceSection):
    type: Literal["anchor"]
    fails: bool = False
    until_s: float = 1e9
    def build(self, setup, rng):
        return Held(1 / (not self.fails), self.until_s)

class Held(Disturbance):
    def __init__(self, one, until_s):
        self.until_s = until_s
    def varied(self, a, speed, time_s):
        if time_s > self.until_s:
            raise SystemExit("no more")
        goes = np.arange(a.size) > 0
        return goes * a, goes * speed
"""
MODULES = {"east": EAST, "anchor": ANCHOR}


@pytest.fixture
def tetractl(tmp_path):
    site = install(tmp_path / "site", "mine", "1.0", POINTS, **MODULES)
    (tmp_path / "one.yaml").write_text(SPEC, encoding="utf-8")
    return lambda *words: process(tmp_path, *words, env={"PYTHONPATH": str(site)})


def place_of(folder, name, text):
    numbered = enumerate(MODULES[name].splitlines(), 1)
    first = next(number for number, line in numbered if text in line)
    return f"{folder}/site/{name}.py:{first}"


def test_a_controllers_exception_names_the_plugins_and_its_calls_are_in_the_log(tetractl, tmp_path):
    done = tetractl("run", "one.yaml", "--out", "logs", "--set", "controller.fails_at=3", "--quiet")
    text = "ZeroDivisionError: division by zero; the spec uses these plug-ins: mine 1.0"
    assert done.returncode == 1
    assert done.stderr.endswith(f"\nerror: trial 1: {text}\n")
    info = tetractl("info", "logs/trial-000.mcap").stdout
    where = place_of(tmp_path, "east", "1 / (self")
    assert f"debug    {where} in plan: 1 / (self.section.fails_at - self.k)" in info
    assert f"aborted ({text}) after 3 control steps" in info


def test_an_exception_in_a_process_of_its_own_names_the_plugins_too(tetractl):
    """It comes back without its traceback."""
    failing = ("--set", "plant.disturbances=[{type: anchor, fails: true}]")
    done = tetractl("run", "one.yaml", "--jobs", "2", "--set", "trials.count=2", *failing)
    assert done.returncode == 1
    assert (
        "ZeroDivisionError: division by zero; the spec uses these plug-ins: mine 1.0" in done.stderr
    )


def test_a_disturbance_that_fails_at_the_stop_too_leaves_a_complete_log(tetractl):
    """Regression: the stop asked it again, and the log stayed a .part without a result."""
    failing = "plant.disturbances=[{type: anchor, until_s: 0.5}]"
    done = tetractl("run", "one.yaml", "--out", "logs", "-q", "--set", failing)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last == "error: trial 1: SystemExit: no more; the spec uses these plug-ins: mine 1.0"
    assert tetractl("info", "logs/trial-000.mcap").returncode == 0
    assert tetractl("verify", "logs").ok().stdout.startswith("logs/trial-000.mcap: ok")
