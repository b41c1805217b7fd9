"""Tests of converting bodies to poses, with a fake of the motion-capture library."""

import io
import json
import math
import os
import signal
import types

import pytest
from testkit.lab_specs import SPEC
from tetractl_emulator.emulated_lab import EmulatedLab
from tetractl_emulator.script import NO_FAULTS
from tetractl_emulator.sides import Options
from tetractl_emulator.virtual_lab import LabClock, start_emulated_lab
from tetractl_motioncapture.bridge import stream
from tetractl_motioncapture.camera import MotionCapture
from tetractl_motioncapture.process_port import ProcessPort

from tetractl.core.clock import MonotonicClock, wait_for
from tetractl.core.errors import AbortError
from tetractl.spec.load import parse_spec

CAPTURE = """
  camera:
    type: motioncapture
    system: vicon
    hostname: 192.168.1.10
    up_axis: {up}
    origin: [120, -40]
    rotation: 0.7
    robots:
      - {{name: green, body: G, heading_offset: 0.3}}
      - {{name: blue, body: B}}
"""
LIBRARY = """
import os, time

class Body:
    position = [0.1, 0.2, 0.0]
    rotation = type("Quaternion", (), {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0})

class Capture:
    rigidBodies = {"G": Body, "B": Body}
    def waitForNextFrame(self):
        time.sleep(0.01)

def connect(system, options):
    if system == "vrpn":
        raise RuntimeError("no connection")
    os.write(1, b"VRPN Error: no response\\n")  # as VRPN's library does
    return Capture()
"""


def lab_of(up="z"):
    head, rest = SPEC.split("  camera:\n")
    actuator = rest[rest.index("  actuator:") :]
    text = head + CAPTURE.format(up=up).lstrip("\n") + actuator
    experiment = parse_spec(text, "capture.yaml").experiment
    return experiment.lab, experiment.setup


@pytest.mark.parametrize("up", ["y", "z"])
def test_poses_are_those_of_the_emulated_bodies_in_the_axes_of_the_system(up):
    lab, setup = lab_of(up)
    clock = LabClock()
    emulation: EmulatedLab = start_emulated_lab(lab, setup, clock, Options(address=None), NO_FAULTS)
    ports = emulation.wires.ports
    with MotionCapture(lab.camera, setup, clock, lambda: None, ports) as camera:
        frame = camera.frames()[-1]
        assert camera.check().emulated and not camera.check().problems
        for pose, x, y, heading in zip(
            frame.poses, setup.starts.x, setup.starts.y, setup.starts.heading, strict=True
        ):
            assert math.isclose(pose.x, x, abs_tol=1e-6)
            assert math.isclose(pose.y, y, abs_tol=1e-6)
            assert math.isclose(math.remainder(pose.heading - heading, math.tau), 0, abs_tol=1e-9)
        assert frame.received_ns - frame.sampled_ns == 10_000_000


def camera_of(*names):
    """A camera that is shown bodies with these names, all at the origin."""
    lab, setup = lab_of()
    port = types.SimpleNamespace(failure=None, close=lambda: None, write=lambda data: 0)
    line = {"bodies": {name: [0, 0, 0, 0, 0, 0, 1] for name in names}}

    def ports(name, baud, device, clock, heard, hint):
        port.open = lambda: heard(json.dumps(line).encode(), 10**9)
        return port

    return MotionCapture(lab.camera, setup, LabClock(), lambda: None, ports)


def test_a_robot_without_a_body_is_named():
    with camera_of("G", "X") as camera:
        assert camera.check().problems == (
            "the system streams no rigid body B for blue; it streams G, X",
        )
        assert [pose is None for pose in camera.frames()[0].poses] == [False, True]


class Pipe(io.StringIO):
    """A pipe whose reader goes away after three lines."""

    def flush(self):
        if self.getvalue().count("\n") == 3:
            raise BrokenPipeError


def test_the_process_prints_bodies_until_no_program_reads_them():
    library = {}
    out = Pipe()
    exec(LIBRARY.replace("time.sleep(0.01)", "pass"), library)
    stream(library["connect"], '["vicon", "there", {}]', out)
    stamps, lines = zip(
        *(splitline.split(" ", 1) for splitline in out.getvalue().splitlines()), strict=True
    )
    assert sorted(map(int, stamps)) == [*map(int, stamps)]
    assert json.loads(lines[0])["bodies"]["G"] == [0.1, 0.2, 0.0, 0.0, 0.0, 0.0, 1.0]


@pytest.fixture
def library(tmp_path, monkeypatch):
    (tmp_path / "motioncapture.py").write_text(LIBRARY)
    folders = [str(tmp_path), os.environ.get("PYTHONPATH", "")]
    path = os.pathsep.join(filter(None, folders))
    monkeypatch.setenv("PYTHONPATH", path)


@pytest.mark.slow
@pytest.mark.system
def test_a_process_that_is_killed_is_a_fault_in_the_next_frame(library):
    lab, setup = lab_of()
    clock = MonotonicClock()
    with lab.camera.build(setup, clock, lambda: None) as camera:
        assert camera.frames()
        assert isinstance(camera._port, ProcessPort)
        os.kill(camera._port._process.pid, signal.SIGKILL)
        gathered = []
        assert wait_for(
            clock,
            lambda: gathered.extend(camera.frames()) or (gathered[-1:] and gathered[-1].fault),
            60,
        )
        assert gathered[-1].fault == "the process that reads the camera has stopped: Killed"
        assert gathered[-1].poses == (None, None)


@pytest.mark.slow
@pytest.mark.system
def test_a_process_that_cannot_connect_is_said(library):
    lab, setup = lab_of()
    section = lab.camera.model_copy(update={"system": "vrpn"})
    with (
        pytest.raises(AbortError, match="the camera has stopped: exit code 1"),
        section.build(setup, MonotonicClock(), lambda: None),
    ):
        pass


@pytest.mark.slow
@pytest.mark.system
def test_the_real_library_streams_from_its_mock_in_the_process():
    pytest.importorskip("motioncapture")
    heard = []
    clock = MonotonicClock()

    def hear(message, stamp_ns):
        heard.append((message, stamp_ns))

    port = ProcessPort('["mock", "", {}]', 0, "it", clock, hear, "")
    port.open()
    came = wait_for(clock, lambda: len(heard) > 3, 60)
    port.close()
    assert came and json.loads(heard[0][0]) == {"bodies": {}}
    assert heard[0][1] <= heard[3][1] <= clock.now()


TURNS = """
class Turns(Capture):
    def waitForNextFrame(self):
        self.rigidBodies = {} if self.rigidBodies else Capture.rigidBodies
"""


@pytest.mark.parametrize(("system", "empty"), [("vrpn", 0), ("vicon", 2)])
def test_a_turn_of_vrpn_without_news_is_no_frame(system, empty):
    """Regression, found with VRPN's own server: robots were lost in every other frame."""
    library = {}
    out = Pipe()
    exec(LIBRARY + TURNS, library)
    stream(lambda *_: library["Turns"](), json.dumps([system, "", {}]), out)
    assert out.getvalue().count('"bodies": {}') == empty


def test_long_names_of_bodies_are_cut_and_many_are_counted():
    """Regression: a sender's names of 600 characters were printed whole, with their escapes."""
    with camera_of(*(f"{number}\x1b" * 300 for number in range(500))) as camera:
        problem = camera.check().problems[0]
    assert problem.isprintable()
    assert len(problem) < 1500
    assert problem.endswith("and 480 more")
