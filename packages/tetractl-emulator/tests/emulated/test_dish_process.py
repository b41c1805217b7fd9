"""Tests of the emulated microscope and coil driver in a process of their own, over real sockets."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from testkit.emulator.lab_processes import PATIENCE_S
from testkit.microscope.needs_opencv import cv2
from testkit.paths import EXAMPLES
from tetractl_emulator import firmware

pytestmark = pytest.mark.system

assert cv2
DISH = EXAMPLES / "tetrahymena_dish.yaml"
TETRACTL = str(Path(sys.executable).with_name("tetractl"))
SCRIPT = """
about: a small dish of few cells
emulation: {actuator: {cells: 2, strangers: 1}, camera: {specks: 2, rate: 20}}
"""


@pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")
def test_a_microscope_is_served_over_http_and_checked_with_its_driver(tmp_path):
    (tmp_path / "script.yaml").write_text(SCRIPT)
    small = ("--set", "arena.width=1200", "--set", "arena.height=1200")
    small += (
        "--set",
        "robots={choose: 2, ring: {center: [600, 600], radius: 200}, a: 4, speed: 420}",
    )
    command = [TETRACTL, "lab", "emulate", DISH, *small, "--command-port", "0", "--json"]
    command += ["--port-link", tmp_path / "coils", "--script", tmp_path / "script.yaml"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as emulator:
        try:
            ready = json.loads(emulator.stdout.readline())
            where = ("--set", f"lab.camera.source.url={ready['url']}")
            where += ("--set", f"lab.actuator.port={ready['port']}")
            check = [TETRACTL, "lab", "check", DISH, *small, *where, "--json"]
            done = subprocess.run(check, capture_output=True, text=True, timeout=PATIENCE_S)
        finally:
            emulator.terminate()
    printed = json.loads(done.stdout)
    assert printed["facts"]["resolution"] == "440x440"
    assert printed["facts"]["emulated"] == "camera"
    assert printed["facts"]["field_driver_version"] == "1"
    assert float(printed["facts"]["rate"].split()[0]) > 3
