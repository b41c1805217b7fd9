"""Camera and actuator of the example, at the other end of wires; and as a user runs them."""

import json
import math
import re
import shutil
import subprocess
import sys

import pytest
from testkit.packages import python
from testkit.paths import ROOT
from tetractl_vw.actuator import VwSection
from tetractl_vw.camera import JsonPoses, JsonPosesSection

from tetractl.core.clock import VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.errors import AbortError, UsageError
from tetractl.core.poses import Pose
from tetractl.spec.lab_template import lab_template
from tetractl.spec.load import load_spec

PACKAGE = ROOT / "examples" / "tetractl-vw"


@pytest.fixture(scope="module")
def setup():
    return load_spec(ROOT / "experiments/three_m3pi.yaml").experiment.setup


class Wire:
    """A port that keeps what is written, and whose other end a test plays."""

    def __init__(self, name, baud, device, clock, heard, hint):
        self.heard, self.sent, self.failure, self.asked = heard, [], None, lambda: None

    def open(self):
        pass

    def settle(self):
        pass

    def close(self):
        pass

    def write(self, data):
        if self.failure:
            raise AbortError(self.failure)
        self.sent.append(data)
        self.asked()
        return 7


def line(**robots):
    return json.dumps({"emulated": True, "robots": robots}).encode()


def camera(setup, answers):
    section, wires = JsonPosesSection(type="json-poses", latency=0.02), []

    def port(*arguments):
        wires.append(Wire(*arguments))
        wires[0].asked = lambda: [wires[0].heard(each, 10**9) for each in answers]
        return wires[0]

    return JsonPoses(section, setup, VirtualClock(), ports=port)


def test_a_line_of_the_camera_is_a_frame_exposed_earlier(setup):
    good = line(green=[100, 200, 0.5], blue=None)
    with camera(setup, [good, b"garbage", b"[]", b'{"robots": {"green": [1]}}']) as opened:
        (frame,) = opened.frames()
        assert (frame.sampled_ns, frame.received_ns) == (980_000_000, 10**9)
        seen = dict(zip(setup.names, frame.poses, strict=True))
        mm = setup.metres * 1000
        assert seen["green"] == Pose(100 / mm, 200 / mm, 0.5)
        assert seen["blue"] is None and seen["red"] is None
        assert opened.damaged == 3 and opened.check().emulated


def test_lines_are_speed_and_turning_rate_and_a_lost_robot_keeps_no_other_from_its_stop(setup):
    section = VwSection(
        type="vw",
        robots=[
            {"name": name, "address": f"udp://127.0.0.1:{9801 + i}", "radius_mm": 40}
            for i, name in enumerate(setup.names)
        ],
    )
    assert list(section.contradictions(setup)) == []
    wires = []

    def port(*arguments):
        wires.append(Wire(*arguments))
        return wires[-1]

    actuator = section.build(setup, VirtualClock())
    actuator = type(actuator)(section, setup, VirtualClock(), port)
    with actuator:
        poses = [Pose(0.0, 0.0, 0.0)] * len(wires)
        sent = actuator.send(Steer(math.pi / 2), poses, (True,) * len(wires), 0)
        v, w = map(float, wires[0].sent[-1].split())
        left, right = sent.left[0] * setup.metres * 1000, sent.right[0] * setup.metres * 1000
        assert w > 0 and math.isclose(2000 * v, left + right, abs_tol=0.2)
        assert math.isclose(80 * w, right - left, abs_tol=0.02)
        wires[0].failure = "gone"
        with pytest.raises(AbortError, match="gone"):
            actuator.stop()
        assert [wire.sent[-1] for wire in wires[1:]] == [b"0.0000 0.0000\n"] * (len(wires) - 1)


@pytest.mark.system
@pytest.mark.slow
def test_what_the_guide_shows_runs(tmp_path):
    source, site = tmp_path / "source", tmp_path / "site"
    shutil.copytree(PACKAGE, source)  # building leaves files next to the source
    options = "--quiet --no-deps --no-build-isolation --no-index --disable-pip-version-check"
    pip = (sys.executable, "-m", "pip", "install", *options.split(), "--target", site, source)
    subprocess.run(pip, check=True, capture_output=True)

    def tetractl(words):
        done = python(tmp_path, [site], "-m", "tetractl", *words.split())
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    tetractl("init vw --lab --robots vw")
    played = tetractl("run vw.yaml --plant emulated --trials 1 --quiet --out logs")
    assert "1 of 1 trials valid" in played
    assert "bit-identical" in tetractl("verify logs")
    assert "1 day, 0 violations" in tetractl(
        "lab rehearse vw.yaml --days 1 --jobs 1 --no-faults --out days"
    )


def test_the_guide_counts_the_lines_that_are_not_blank():
    guide = (ROOT / "docs" / "how-to" / "own-robots.md").read_text("utf-8")
    rows = re.findall(r"^\| `([\w/.]+)` \|.*\| (\d+) \|$", guide, re.MULTILINE)
    counted = []
    for name, _ in rows:
        file = PACKAGE / name if "/" in name else PACKAGE / "tetractl_vw" / name
        lines = file.read_text("utf-8").splitlines()
        counted.append((name, str(sum(bool(line.strip()) for line in lines))))
    assert len(rows) == 4 and counted == rows


def test_init_says_that_a_camera_has_no_template():
    """Regression: it was called unknown, though its package is installed."""
    with pytest.raises(UsageError, match=r"has no template cameras/json-poses\.yaml"):
        lab_template("twist", "json-poses")
