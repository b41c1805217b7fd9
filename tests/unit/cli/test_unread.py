import os
import sys
import threading
from contextlib import contextmanager
from io import BytesIO

import pytest

from tetractl.cli import unread
from tetractl.cli.unread import (
    MarkedStream,
    Messages,
    PluginWords,
    close_stdout,
    give_up_unread,
    say_at_once,
)
from tetractl.core.registry import SPEAKERS
from tetractl.tools.children import LINES_MAX, SHOWN_LINE_MAX

STDOUT = 1
STDERR = 2


@contextmanager
def stderr_pipe():
    """The reading and the writing end of a pipe that is the process's stderr meanwhile.

    This is no fixture, because pytest replaces stderr between a fixture and its test.
    """
    reading, writing = os.pipe()
    real = os.dup(STDERR)
    os.dup2(writing, STDERR)
    try:
        yield reading, writing
    finally:
        os.dup2(real, STDERR)
        os.close(real)
        os.close(writing)
        os.close(reading)


def fill(descriptor):
    os.set_blocking(descriptor, False)
    try:
        while True:
            os.write(descriptor, b"." * 4096)
    except BlockingIOError:
        os.set_blocking(descriptor, True)


def test_messages_that_nobody_can_read_are_no_error():
    with stderr_pipe() as (reading, writing):
        os.dup2(writing, reading)  # the pipe has no reader any more
        assert Messages().write(b"message") == 7
        say_at_once(b"message")


def test_what_a_signal_says_never_waits():
    with stderr_pipe() as (reading, writing):
        say_at_once(b"first")
        fill(writing)
        say_at_once(b"lost")
        os.set_blocking(reading, False)
        said = os.read(reading, 1_000_000)
    assert said.strip(b".") == b"first"


def test_a_signal_frees_a_thread_whose_message_nobody_reads():
    with stderr_pipe() as (_, writing):
        fill(writing)
        thread = threading.Thread(target=Messages().write, args=(b"." * 100,), daemon=True)
        thread.start()
        give_up_unread()
        thread.join(60.0)
        assert not thread.is_alive()


def test_results_that_cannot_be_written_are_lost_before_the_interpreter_ends(monkeypatch):
    real = os.dup(STDOUT)
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, STDOUT)
    try:
        with os.fdopen(STDOUT, "w", closefd=False) as results:
            monkeypatch.setattr(sys, "stdout", results)
            results.write("result")
            close_stdout()
            results.flush()  # as the interpreter does
    finally:
        os.dup2(real, STDOUT)
        os.close(real)
        os.close(full)


@pytest.fixture
def plugin(monkeypatch):
    """Returns a function of a plug-in's module that prints."""
    monkeypatch.setitem(SPEAKERS, "chatty", "camera 'chatty'")
    module = {"__name__": "chatty.inside"}
    exec("import sys\ndef say(text, **how): print(text, **how)", module)
    return module["say"]


def streams(monkeypatch):
    """Let both standard streams be marked ones; returns what they have written, by name."""
    written = {name: BytesIO() for name in ("stdout", "stderr")}
    for name, file in written.items():
        stream = MarkedStream(file, encoding="utf-8", write_through=True)
        monkeypatch.setattr(sys, name, stream)
    monkeypatch.setattr(unread, "WORDS", PluginWords())
    return written


def test_what_a_plug_in_prints_is_marked_and_leaves_the_results_alone(monkeypatch, plugin):
    """Regression: it stood, with its escape sequences, in the JSON of a command."""
    with monkeypatch.context() as patched:
        written = streams(patched)
        plugin("a \x1b[2Jscreen")
        print('{"ours": 1}')
        plugin("to stderr", file=sys.stderr)
        plugin("not ended", end="")
        unread.WORDS.end()
        out, err = (file.getvalue().decode() for file in written.values())
    assert out == '{"ours": 1}\n'
    assert err.splitlines() == [
        r"camera 'chatty': a \x1b[2Jscreen",
        "camera 'chatty': to stderr",
        "camera 'chatty': not ended",
    ]


def test_a_plug_in_that_prints_without_end_is_cut_short(monkeypatch, plugin):
    with monkeypatch.context() as patched:
        written = streams(patched)
        for _ in range(1000):
            plugin("x" * 10_000)
        lines = written["stderr"].getvalue().decode().splitlines()
    assert len(lines) == LINES_MAX + 1
    assert lines[-1] == "camera 'chatty': says more, which is not shown"
    assert max(map(len, lines)) < SHOWN_LINE_MAX + 50


def test_a_package_with_a_command_prints_its_results(monkeypatch, plugin):
    with monkeypatch.context() as patched:
        written = streams(patched)
        patched.setitem(SPEAKERS, "chatty", "")
        plugin("result")
        assert written["stdout"].getvalue() == b"result\n"
