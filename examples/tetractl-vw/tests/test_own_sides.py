"""Robots and cameras of another make: what their emulated sides take from the sections, packets,
cameras that send unasked, and calibration.
"""

import json
import socket
import struct
from queue import Queue
from random import Random

import numpy as np
import pytest
from tetractl_emulator.emulated_udp import UdpPlug
from tetractl_emulator.sides import Options
from tetractl_emulator.virtual_lab import LabClock, start_emulated_lab
from tetractl_vw import TEMPLATES
from tetractl_vw.actuator import VwRobots
from tetractl_vw.camera import JsonPoses, JsonPosesSection
from tetractl_vw.emulated import EmulatedJsonPoses, EmulatedVw

from tetractl.core.clock import SECOND, MonotonicClock
from tetractl.core.errors import AbortError
from tetractl.core.poses import Sight
from tetractl.core.protocols import LabSupervision
from tetractl.lab.udp_port import UdpPort
from tetractl.spec.load import parse_spec
from tetractl.spec.plants import select_plant
from tetractl.spec.yaml.problems import InvalidSpecError

SPEC = (TEMPLATES / "robots" / "vw.yaml").read_text().replace("@NAME@", "name: vw")
GREEN = '{name: green, address: "udp://127.0.0.1:9801"'
PACKET = struct.Struct("<hh")


def vw(old="", new="", plant=None):
    return select_plant(parse_spec(SPEC.replace(old, new), "vw.yaml"), plant).experiment


def emulation(experiment, record=None):
    clock = LabClock()
    options = Options(address=None, record=record)
    return start_emulated_lab(experiment.lab, experiment.setup, clock, options), clock


@pytest.mark.long
def test_robots_that_cannot_answer_are_calibrated_and_emulated_as_the_spec_says():
    """Regression: None was taken for no answer, and the spec's gains and radius were ignored."""
    given = GREEN, f"{GREEN}, left_gain: 1.2, radius_mm: 50"
    experiment = vw(*given, plant="emulated")
    lab, seed = experiment.plant, np.random.SeedSequence(1)

    def rig(limits, setup):
        own = lab.model_copy(update={"limits": limits})
        return own.rig(setup, own.clock(), seed, LabSupervision())

    lines = []
    found = lab.actuator.calibrate(lab, rig, experiment.setup, ["green"], 45, lines.append)
    (green,) = found.actuator["robots"]
    assert green["left_gain"] == pytest.approx(1.2, rel=0.01)
    assert green["right_gain"] == pytest.approx(1.0, rel=0.01)
    assert green["radius_mm"] == pytest.approx(50, rel=0.01)


def test_a_calibrated_lab_is_rehearsed_near_its_calibration():
    experiment = vw(GREEN, f"{GREEN}, left_gain: 1.2")
    drawn = EmulatedVw.world_of_day(Random(1), experiment.lab, experiment.setup)
    assert 1.14 <= drawn["robots"][0]["left_gain"] <= 1.26


def test_an_emulated_camera_has_the_rate_and_the_latency_of_its_section(monkeypatch):
    """Regression: always 100 Hz and 10 ms."""
    monkeypatch.setattr(JsonPosesSection, "sight", Sight(rate_hz=50.0))
    experiment = vw("latency: 0.01", "latency: 0.04")
    lab, clock = emulation(experiment)
    with JsonPoses(experiment.lab.camera, experiment.setup, clock, ports=lab.camera.join) as camera:
        camera.frames()
        clock.sleep_until(clock.now() + SECOND)
        frames = camera.frames()
    assert 49 <= len(frames) <= 51
    assert 0.039 < (clock.now() - max(lab.camera.shown_ns)) / SECOND < 0.062
    drawn = EmulatedJsonPoses.world_of_day(Random(1), experiment.lab, experiment.setup)
    assert 0.033 <= drawn["latency"] <= 0.042


class Packets(VwRobots):
    def packed(self, row, left, right):
        return PACKET.pack(left, right)


def test_a_datagram_is_a_message_whatever_its_bytes_and_garbage_ends_nothing(tmp_path, monkeypatch):
    """Regression: datagrams were cut at each byte 10; what `read` raised ended the trial."""
    monkeypatch.setattr(EmulatedVw, "read", lambda side, message, row: PACKET.unpack(message))
    experiment = vw()
    record = tmp_path / "record.jsonl"
    lab, clock = emulation(experiment, record)
    section, setup, ports = experiment.lab.actuator, experiment.setup, lab.wires.ports
    with Packets(section, setup, clock, ports) as robots:
        for message in (robots.packed(0, 10, 266), b"no packet"):
            robots.links.ports[0].write(message)
        clock.sleep_until(clock.now() + SECOND // 50)
        noted = [json.loads(line) for line in record.read_text().splitlines()]
        assert [row["motors"] for row in noted if row["event"] == "command"] == [[10, 266]]
        assert [row["hex"] for row in noted if row["event"] == "garbage"] == [b"no packet".hex()]
        assert lab.actuator.robots[0].counts() == (10, 266)
    lab.close()


@pytest.fixture
def free():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("", 0))
        number = one.getsockname()[1]
    return f"udp://:{number}"


def test_a_camera_that_sends_unasked_is_heard_and_emulated(free):
    heard = Queue()
    given = 0, "the camera", MonotonicClock(), lambda data, now: heard.put(data), ""
    port, second, plug = UdpPort(free, *given), UdpPort(free, *given), UdpPlug(free)
    port.open()
    plug.plug()
    try:
        port.write(b"poses\n")
        plug.write(b"{}")
        assert heard.get(timeout=60) == b"{}"
        with pytest.raises(AbortError, match=f"{free}: Address already in use"):
            second.open()
    finally:
        for one in (port, second):
            one.close()
        plug.unplug()


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("watchdog: 0.25", "watchdog: 0.5", "stop after 0.25 s without a command"),
        ("type: vw", "type: vw\n    rate: 11", "for three commands within 0.25 s"),
        (
            "speed: 200",
            "speed: 600",
            "speed_max_mm_s: is below the speed of blue, which is 600 mm/s",
        ),
        ("udp://127.0.0.1:9801", "udp://:9801", "must be udp://HOST:PORT"),
        ("udp://127.0.0.1:9802", "udp://127.0.0.1:9801", "is also the value of green"),
    ],
)
def test_what_robots_of_another_make_cannot_do_is_refused(old, new, what):
    with pytest.raises(InvalidSpecError, match=what):
        vw(old, new)
