import os
import signal
import socket
import subprocess
import sys

import pytest

from tetractl.core.errors import LogError, UsageError
from tetractl.run.folder_lock import LOCK_FILE, locked

HOLD = """
import sys
from pathlib import Path
from tetractl.run.folder_lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the lock of tmp_path."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, tmp_path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout and process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_run_is_refused_and_told_who_has_the_folder(tmp_path, holder):
    in_use = f"in use by process {holder.pid} of .* on "
    with pytest.raises(UsageError, match=in_use) as caught, locked(tmp_path):
        pass
    assert caught.value.hint and "--out" in caught.value.hint
    assert (tmp_path / LOCK_FILE).exists()


def test_the_lock_of_a_run_that_ended_is_free_and_gone(tmp_path, holder):
    holder.communicate("")
    assert not (tmp_path / LOCK_FILE).exists()
    with locked(tmp_path):
        owner = (tmp_path / LOCK_FILE).read_text().split()
        assert owner[:2] == [socket.gethostname(), str(os.getpid())]
    assert not (tmp_path / LOCK_FILE).exists()


def test_the_lock_of_a_killed_run_is_stale(tmp_path, holder):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (tmp_path / LOCK_FILE).exists()
    with locked(tmp_path):
        pass


def test_the_file_of_another_host_is_believed_until_a_person_removes_it(tmp_path):
    (tmp_path / LOCK_FILE).write_text("else\x1b[2Jwhere 12 ann 2026-01-01T00:00:00Z")
    in_use = r"process 12 of ann on else\?\[2Jwhere since"  # no escape sequence is printed
    with pytest.raises(UsageError, match=in_use) as caught, locked(tmp_path):
        pass
    assert caught.value.hint and LOCK_FILE in caught.value.hint
    (tmp_path / LOCK_FILE).unlink()
    with locked(tmp_path):
        pass


def test_a_folder_that_cannot_be_locked_is_one_clear_line(tmp_path):
    (tmp_path / LOCK_FILE).symlink_to(tmp_path / "other")
    with pytest.raises(LogError, match="the folder cannot be locked"), locked(tmp_path):
        pass


def test_a_folder_that_vanishes_meanwhile_is_no_second_error(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    with locked(folder):
        (folder / LOCK_FILE).unlink()
        folder.rmdir()
