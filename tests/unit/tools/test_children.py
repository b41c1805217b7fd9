"""Tests of child processes: their imports, and which of their output is shown."""

import errno
import os
import signal
import sys
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import forkserver

import pytest

from tetractl.tools.children import (
    OUTPUT_BYTES_MAX,
    SAFE_PATH_VARIABLE,
    SHOWN_LINE_MAX,
    Child,
    build_python_command,
    run_tool,
    split_printable_lines,
)
from tetractl.tools.worker_pool import (
    WorkerPool,
    create_clean_context,
    create_fork_context,
    exclude_current_folder,
)

MODULE = "raise SystemExit('the module of the present folder was run')\n"


def said_by(code):
    """Return the exit code of a Python child that ran a code, and the lines that it said."""
    with Child([sys.executable, "-c", code]) as child:
        return child.wait(), child.error_lines()


def test_a_module_in_the_present_folder_is_not_imported(tmp_path, monkeypatch):
    """Regression: the camera's process ran a json.py next to the spec."""
    for name in ("json", "base64", "ctypes"):
        (tmp_path / f"{name}.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    with Child(build_python_command("json.tool", "--help")) as child:
        assert "usage" in child.stdout.read().decode()
        assert child.wait() == 0


def test_what_a_child_says_is_printable_and_in_lines():
    code, said = said_by(r"import sys; sys.stderr.write('\x1b]52;c;xxx\x07a\n\nb\n'); exit(3)")
    assert code == 3
    assert said == [r"\x1b]52;c;xxx\x07a", "b"]


def test_what_a_child_says_is_bounded():
    code, said = said_by("import sys; sys.stderr.write(('x' * 5000 + chr(10)) * 2000 + 'end')")
    assert code == 0
    assert said[-1] == "end"
    assert all(len(line) <= SHOWN_LINE_MAX for line in said)
    assert sum(map(len, said)) <= OUTPUT_BYTES_MAX


def test_a_tool_gives_its_code_its_print_and_its_words():
    code = "import sys; print('out'); sys.stderr.write('why'); exit(4)"
    done = run_tool([sys.executable, "-c", code])
    assert (done.returncode, done.stdout, done.stderr) == (4, b"out\n", b"why")


def test_a_tool_that_does_not_end_or_does_not_exist_is_an_error_of_the_system():
    with pytest.raises(TimeoutError, match="does not end"):
        run_tool([sys.executable, "-c", "import signal; signal.pause()"], timeout_s=0.1)
    with pytest.raises(FileNotFoundError) as missing:
        run_tool(["no-such-tool-of-tetractl"])
    assert missing.value.errno == errno.ENOENT


def print_hostile(number):
    print(f"\x1b[2J {number}")
    os.write(2, b"to the descriptor\n")
    return number


def test_what_workers_print_is_told_by_lines_with_who_printed():
    """Regression: a plug-in's `print` in a worker reached the terminal with its escapes."""
    lines = []
    with WorkerPool(create_fork_context(), 1, "a worker", lines.append) as pool:
        assert pool.submit(print_hostile, 7).result() == 7
    assert lines == [r"a worker: \x1b[2J 7", "a worker: to the descriptor"]


def test_a_killed_child_tells_the_signal():
    with Child([sys.executable, "-c", "import signal; signal.pause()"]) as child:
        child.kill()
        child.kill()
        assert child.wait() == -signal.SIGKILL


def test_workers_start_again_after_their_server_was_killed():
    """Regression: the error of the connection to it ended the command as "interrupted"."""
    context = create_clean_context()
    with WorkerPool(context, 1, "a worker", print) as pool:
        assert pool.submit(abs, -1).result() == 1
    os.kill(forkserver._forkserver._forkserver_pid, signal.SIGKILL)
    with WorkerPool(context, 1, "a worker", print) as pool:
        lost = pool.submit(abs, -2)
        assert lost.exception() is None or isinstance(lost.exception(), BrokenProcessPool)
    with WorkerPool(context, 1, "a worker", print) as pool:
        assert pool.submit(abs, -3).result() == 3


def test_bytes_that_are_no_text_are_shown_as_such():
    assert split_printable_lines(b"\xff\x00\n \n") == ["\ufffd\\x00"]


@pytest.mark.parametrize("before", [None, "", "1"])
def test_the_variable_of_isolated_is_as_before_at_its_end(before, monkeypatch):
    monkeypatch.delenv(SAFE_PATH_VARIABLE, raising=False)
    if before is not None:
        monkeypatch.setenv(SAFE_PATH_VARIABLE, before)
    with exclude_current_folder():
        assert os.environ[SAFE_PATH_VARIABLE] == "1"
    assert os.environ.get(SAFE_PATH_VARIABLE) == before


def print_much():
    for number in range(1000):
        print(number)


def test_what_workers_print_is_bounded():
    lines = []
    with WorkerPool(create_fork_context(), 1, "a worker", lines.append) as pool:
        pool.submit(print_much).result()
    assert lines[-2:] == ["a worker: 49", "a worker: further output of this process is not shown"]
    assert len(lines) == 51
