"""A batch of two short trials of two robots on wheels, used by several test files."""

import pytest

from testkit.cli import tetractl

QUICK_PAIR = """
name: quick
arena: {left: 0, bottom: 0, width: 1000, height: 800}
robots:
  - {name: one, start: [300, 500], target: [600, 500], a: 6, speed: 100}
  - {name: two, start: [300, 200], target: [600, 250], a: 3, speed: 100}
wheels: {radius: 45}
controller: {type: pso-mpc, motion: exact, horizon_max: 20,
  optimizer: {particles: 20, iterations: 20}}
plant:
  type: sim
  dead_time: 0.1
  heading_noise: 0.02
  measurement_noise: {position: 0.3, heading: 0.005}
trials: {count: 2, seed: 7}
"""


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A folder with `quick.yaml` and the `logs` of its two trials."""
    place = tmp_path_factory.mktemp("quick")
    (place / "quick.yaml").write_text(QUICK_PAIR)
    assert tetractl(place, "run", "quick.yaml", "--out", "logs", "--quiet").returncode == 0
    return place
