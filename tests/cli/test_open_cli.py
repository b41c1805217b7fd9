"""`tetractl open`: a real server, asked as a browser would."""

import re
import signal
import subprocess
from urllib.request import Request, urlopen

import pytest
from support import random_trials as made
from support.running import TETRACTL


@pytest.fixture
def log(tmp_path):
    return made.write(made.trial(1, steps=3, frames=20), tmp_path / "trial-000.mcap")


def test_a_trial_is_served_until_ctrl_c(log):
    process = subprocess.Popen(
        [TETRACTL, "open", log.name, "--no-browser", "--lichtblick", "http://127.0.0.1:1"],
        cwd=log.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{16,}/", url)
        with urlopen(url) as page:
            assert b'id="trial-data-0"' in page.read()
        asked = Request(f"{url}logs/0-trial-000.mcap", headers={"Range": "bytes=0-7"})
        with urlopen(asked) as part:
            assert (part.status, part.read()) == (206, log.read_bytes()[:8])
        process.send_signal(signal.SIGINT)
        rest, errors = process.communicate(timeout=120)
    finally:
        process.kill()
    assert (process.returncode, rest) == (0, "")
    assert "ssh -L" in errors
    assert "Traceback" not in errors
