import os
import select
import sys
import threading
from contextlib import contextmanager

from tetractl.cli.unread import (
    Messages,
    close_stdout,
    give_up_unread,
    notice_of_signals,
    say_at_once,
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


def test_a_message_waits_for_its_reader_also_if_its_pipe_does_not_block():
    with stderr_pipe() as (reading, writing):
        fill(writing)
        os.set_blocking(writing, False)
        thread = threading.Thread(target=Messages().write, args=(b"message",))
        thread.start()
        said = b""
        while not said.endswith(b"message"):
            said += os.read(reading, 65536)
        thread.join()


def test_the_first_signal_is_told_once():
    with stderr_pipe() as (reading, _):
        notice = notice_of_signals(b"stopping\n")
        notice(1)
        notice(2)
        assert os.read(reading, 100) == b"stopping\n"
        assert not select.select([reading], [], [], 0)[0]
