"""Emulated robots whose program twist.py is run by MicroPython under Node.js."""

import os
import shutil
import subprocess
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from tetractl_emulator.twist import side

from testkit.paths import FIRMWARE
from tetractl.lab.actuators.wheel_commands import Status

FOLDER = FIRMWARE / "micropython"
BRIDGE = Path(__file__).with_suffix(".mjs")
MODULES = Path(os.environ.get("NODE_PATH", "")) / "@micropython"
MISSING = shutil.which("node") is None or not MODULES.is_dir()


@contextmanager
def micropython_robots():
    """Robots that are made within the block run in MicroPython; yields the names of what has run
    them."""
    words = ["node", str(BRIDGE), str(FOLDER)]
    ran = set()
    node = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    class Program:
        """A `TwistCore` in MicroPython."""

        def __init__(self, index, radius_mm):
            self._row = ask("make", index, radius_mm)

        def push(self, data, now_ms):
            ran.add(ask("push", self._row, now_ms, data.hex()))

        def wheels(self, now_ms):
            words = ask("wheels", self._row, now_ms).split()
            return tuple(int(word) for word in words)

        def status(self, now_ms):
            return Status(int(ask("status", self._row, now_ms)))

        def take_reply(self, now_ms):
            return bytes.fromhex(ask("reply", self._row, now_ms))

        def set_battery(self, battery_mv):
            ask("battery", self._row, battery_mv)

    def ask(*what):
        node.stdin.write(" ".join(map(str, what)) + "\n")
        node.stdin.flush()
        return node.stdout.readline().rstrip("\n")

    with node, mock.patch.object(side, "TwistCore", Program):
        yield ran
        node.stdin.close()
