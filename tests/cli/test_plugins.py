"""Tests of kinds from other packages: the installed example package, and a broken one."""

import json
import subprocess
import sys

import pytest
from testkit.packages import python
from testkit.paths import ROOT

pytestmark = pytest.mark.system

EXAMPLE = ROOT / "examples" / "tetractl-example"
SPEC = """
name: two
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: a, start: [200, 500], target: [400, 500], a: 6, speed: 180}
  - {name: b, start: [200, 700], target: [400, 750], a: 3, speed: 150}
controller:
  type: pso-mpc
  horizon_max: 7
  time_limit: 2
  optimizer: {type: random-search, iterations: 20}
trials: {count: 2}
"""
CAMERA = """
import threading
from tetractl import load_spec
from tetractl.core.clock import VirtualClock

reached, finished = threading.Event(), threading.Event()

class ClockUpTo150Ms(VirtualClock):
    def sleep_until(self, when):
        if when > 150_000_000:
            reached.set()
            finished.wait()
        super().sleep_until(when)

setting = "lab.camera={type: csv-camera, file: poses.csv, rate: 50}"
experiment = load_spec("three.yaml", setting).experiment
woken = []
camera = experiment.lab.camera.build(
    experiment.setup, ClockUpTo150Ms(), lambda: woken.append(1)
)
with camera:
    reached.wait()
    frames = camera.frames()
    finished.set()
assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
assert [frame.sampled_ns / 1e6 for frame in frames] == [0, 50, 100, 120, 140]
assert [frame.poses[0] is None for frame in frames] == [False, True, False, False, False]
assert [frame.poses[1].x for frame in frames] == [200, 215, 230, 230, 230]
assert frames[0].poses[0].heading == 0.5
assert len(woken) >= 5
print(camera.check().facts)
"""
POSES = """time_s,robot,x,y,heading
1.00,a,200,500,0.5
1.00,b,200,700,0
1.05,b,215,700,0
1.10,a,210,500,0
1.10,b,230,700,0
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder into which pip has installed the example package."""
    folder = tmp_path_factory.mktemp("site")
    source = folder / "source"  # building leaves files next to the source
    for path in (p for p in EXAMPLE.rglob("*") if p.is_file() and p.suffix in (".py", ".toml")):
        target = source / path.relative_to(EXAMPLE)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(path.read_bytes())
    options = "--quiet --no-deps --no-build-isolation --no-index --disable-pip-version-check"
    pip = [sys.executable, "-m", "pip", "install", *options.split()]
    done = subprocess.run(
        [*pip, "--target", folder / "installed", source], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return folder / "installed"


def tetractl(folder, sites, *arguments):
    return python(folder, sites, "-m", "tetractl", *arguments)


@pytest.fixture(scope="module")
def logged(site, tmp_path_factory):
    """A folder with a spec that uses the example's optimizer, and its logs."""
    folder = tmp_path_factory.mktemp("logged")
    (folder / "two.yaml").write_text(SPEC, encoding="utf-8")
    done = tetractl(folder, [site], "run", "two.yaml", "--out", "logs", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["n_counted"] == 2
    return folder


def test_a_log_names_the_package(logged, site):
    done = tetractl(logged, [site], "info", "logs/trial-000.mcap", "--json")
    assert json.loads(done.stdout)["provenance"]["package.tetractl-example"] == "0.1.0"


def test_without_the_package_the_log_says_what_to_install(logged):
    done = tetractl(logged, [], "info", "logs/trial-000.mcap")
    assert done.returncode == 1
    assert "random-search: must be one of" in done.stderr
    assert "this log was written with tetractl-example 0.1.0: install this version" in done.stderr


def test_the_examples_camera_shows_the_files_frames(site, tmp_path):
    lab = (ROOT / "experiments" / "three_m3pi_lab.yaml").read_text("utf-8")
    (tmp_path / "three.yaml").write_text(lab, encoding="utf-8")
    poses = POSES.replace(",a,", ",green,").replace(",b,", ",blue,")
    (tmp_path / "poses.csv").write_text(poses, encoding="utf-8")
    done = python(tmp_path, [site], "-c", CAMERA)
    assert done.returncode == 0, done.stderr
    assert "poses.csv" in done.stdout


def test_kinds_are_listed_with_their_package(site, tmp_path):
    done = tetractl(tmp_path, [site], "kinds")
    assert done.returncode == 0
    lines = [line.split() for line in done.stdout.splitlines()]
    code = "tetractl_example.random_search:RandomSearch"
    assert ["optimizer", "random-search", "tetractl-example", "0.1.0", code] in lines
    done = tetractl(tmp_path, [site], "kinds", "--json")
    (camera,) = [k for k in json.loads(done.stdout)["kinds"] if k["type"] == "csv-camera"]
    assert camera["seam"] == "camera"
    assert camera["package"] == "tetractl-example"
    assert camera["problem"] is None


def test_an_unknown_type_is_answered_with_what_is_installed(site, tmp_path):
    (tmp_path / "two.yaml").write_text(SPEC.replace("random-search", "random"), encoding="utf-8")
    done = tetractl(tmp_path, [site], "validate", "two.yaml")
    assert done.returncode == 2
    assert "random-search (from tetractl-example 0.1.0)" in done.stdout
    assert "pso, " in done.stdout
    assert "did you mean 'random-search'?" in done.stdout
