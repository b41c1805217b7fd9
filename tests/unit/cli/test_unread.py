import os
import select
import signal
import stat
import sys
import threading
from contextlib import contextmanager, suppress
from types import SimpleNamespace

import pytest

from tetractl.cli import unread
from tetractl.cli.unread import (
    MessageStream,
    _watch_readers,
    close_stdout,
    create_signal_notice,
    discard_unread_output,
    hang_up_without_reader,
    write_at_once,
)

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
        assert MessageStream().write(b"message") == 7
        write_at_once(b"message")


def test_what_a_signal_says_never_waits():
    with stderr_pipe() as (reading, writing):
        write_at_once(b"first")
        fill(writing)
        write_at_once(b"lost")
        os.set_blocking(reading, False)
        said = os.read(reading, 1_000_000)
    assert said.strip(b".") == b"first"


def test_a_signal_frees_a_thread_whose_message_nobody_reads():
    with stderr_pipe() as (_, writing):
        fill(writing)
        thread = threading.Thread(target=MessageStream().write, args=(b"." * 100,), daemon=True)
        thread.start()
        discard_unread_output()
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


def test_a_message_waits_for_its_reader_also_if_its_pipe_does_not_block():
    with stderr_pipe() as (reading, writing):
        fill(writing)
        os.set_blocking(writing, False)
        thread = threading.Thread(target=MessageStream().write, args=(b"message",))
        thread.start()
        said = b""
        while not said.endswith(b"message"):
            said += os.read(reading, 65536)
        thread.join()


def test_the_first_signal_is_told_once():
    with stderr_pipe() as (reading, _):
        notice = create_signal_notice(b"stopping\n")
        notice(1)
        notice(2)
        assert os.read(reading, 100) == b"stopping\n"
        assert not select.select([reading], [], [], 0)[0]


# robots whose output nobody reads


@pytest.fixture
def streams(monkeypatch):
    """Let stdout and stderr be of these kinds; returns which streams are watched in a block."""
    watched = []

    def block(stdout, stderr, **options):
        modes = {"pipe": stat.S_IFIFO, "socket": stat.S_IFSOCK, "file": stat.S_IFREG,
                 "terminal": stat.S_IFCHR, "null device": stat.S_IFCHR}  # fmt: skip
        kinds = {STDOUT: stdout, STDERR: stderr}
        monkeypatch.setattr(
            unread.os, "fstat", lambda stream: SimpleNamespace(st_mode=modes[kinds[stream]])
        )
        monkeypatch.setattr(unread.os, "isatty", lambda stream: kinds[stream] == "terminal")
        monkeypatch.setattr(
            unread, "_watch_readers", lambda streams, ended, thread: watched.append(streams)
        )
        with hang_up_without_reader(**options):
            pass
        monkeypatch.undo()
        return watched.pop() if watched else None

    return block


@pytest.mark.parametrize(
    ("stdout", "stderr", "watched"),
    [
        ("pipe", "file", [STDOUT]),
        ("file", "pipe", [STDERR]),
        ("socket", "pipe", [STDOUT, STDERR]),
        ("terminal", "terminal", [STDOUT, STDERR]),
        ("terminal", "null device", [STDOUT]),
        ("file", "file", None),
        ("file", "null device", None),
    ],
)
def test_only_streams_that_have_readers_are_watched(streams, stdout, stderr, watched):
    assert streams(stdout, stderr) == watched


def test_nothing_is_watched_without_robots_or_unattended(streams):
    assert streams("pipe", "pipe", moves_robots=False) is None
    assert streams("pipe", "pipe", moves_robots=True, unattended=True) is None
    assert streams("pipe", "pipe", moves_robots=True) == [STDOUT, STDERR]


@pytest.mark.parametrize("fails", [False, True])
def test_an_unattended_run_ignores_a_closed_terminal_only_while_it_runs(fails):
    before = signal.getsignal(signal.SIGHUP)
    try:
        with suppress(ZeroDivisionError), hang_up_without_reader(unattended=True):
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            if fails:
                raise ZeroDivisionError
        assert signal.getsignal(signal.SIGHUP) is before
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.fixture
def hung_up():
    """The signals that reach this process meanwhile."""
    received = []
    before = signal.signal(signal.SIGHUP, lambda number, _: received.append(number))
    yield received
    signal.signal(signal.SIGHUP, before)


def watch(streams, ended):
    _watch_readers(streams, ended, threading.get_ident())


def test_a_signal_is_sent_once_no_stream_has_a_reader(hung_up):
    one_reading, one = os.pipe()
    two_reading, two = os.pipe()
    ended = threading.Event()
    try:
        os.close(one_reading)
        os.close(two_reading)
        watch([one, two], ended)
        assert hung_up == [signal.SIGHUP]
    finally:
        os.close(one)
        os.close(two)


def test_no_signal_is_sent_while_one_stream_has_a_reader_until_the_run_ends(hung_up):
    one_reading, one = os.pipe()
    two_reading, two = os.pipe()

    class EndsAfterSomeLooks:
        looks = 0

        def is_set(self):
            self.looks += 1
            return self.looks > 3

    try:
        os.close(one_reading)
        watch([one, two], EndsAfterSomeLooks())
        assert hung_up == []
    finally:
        for descriptor in (one, two, two_reading):
            os.close(descriptor)


def test_no_signal_is_sent_if_the_run_has_ended(hung_up):
    reading, writing = os.pipe()
    ended = threading.Event()
    ended.set()
    try:
        os.close(reading)
        watch([writing], ended)
        assert hung_up == []
    finally:
        os.close(writing)
