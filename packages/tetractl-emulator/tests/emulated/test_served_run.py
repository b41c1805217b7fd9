"""A run in the emulated lab, seen live by a viewer that reads and by one that does not."""

import re

import pytest
from support.lab_processes import SMALL, SPEC, TETRACTL, Emulator, flags
from support.terminal import Terminal
from support.viewer import Viewer, deaf

from tetractl.log.format.channels import CHANNELS, FRAMES, SCENE, STEP, TRANSFORMS
from tetractl.log.read.salvage import scan

pytestmark = [pytest.mark.system, pytest.mark.release]  # of simulations: test_serve_cli.py


def test_a_viewer_sees_the_frames_of_the_log_while_robots_drive(tmp_path):
    settings = (*SMALL, "lab.limits.late_steps=1000")
    emulator = Emulator(tmp_path, settings)
    try:
        ready = emulator.wait_for("ready")
        settings += (
            f"lab.camera.command_port={ready['command_port']}",
            f"lab.actuator.port={ready['port']}",
        )
        command = [TETRACTL, "run", str(SPEC), "--plant", "lab", "--yes", "--out", "logs"]
        command += ["--serve", "--port", "0", "--quiet", *flags(settings)]
        with Terminal(command, tmp_path, columns=200) as terminal:
            url = re.search(r"ws://\S+", terminal.expect(r"ws://127\.0\.0\.1:\d+/[\w-]{16}\s"))[0]
            with deaf(url, len(CHANNELS)), Viewer(url) as viewer:
                viewer.subscribe()
                viewer.message(SCENE)
                viewer.until(lambda got: got[0] == STEP)
                viewer.until(lambda got: got[0] == FRAMES)
                emulator.wait_for("run")  # it drives, and was not waited for
            assert terminal.finish() in (0, 1)  # on a busy host the guard may stop the robots
        assert "Traceback" not in terminal.raw
        assert "too slow" not in terminal.raw
        log = tmp_path / "logs" / "trial-000.mcap"
        topics = CHANNELS.keys() - {FRAMES, TRANSFORMS}  # of which a log has fewer messages
        logged = {(entry.topic, entry.log_ns, entry.data) for entry in scan(log).entries}
        received = {message for message in viewer.all if message[0] in topics}
        assert received <= logged
    finally:
        emulator.close()
