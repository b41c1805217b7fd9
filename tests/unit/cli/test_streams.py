import errno
import os
import threading

import pytest

from tetractl.cli.streams import Output, PatientWriter


@pytest.fixture
def pipe():
    reading, writing = os.pipe()
    yield reading, writing
    for end in (reading, writing):
        try:
            os.close(end)
        except OSError as error:
            assert error.errno == errno.EBADF


def fill(descriptor):
    os.set_blocking(descriptor, False)
    try:
        while True:
            os.write(descriptor, b"." * 4096)
    except BlockingIOError:
        os.set_blocking(descriptor, True)


def test_what_is_written_has_arrived_when_it_returns(pipe):
    reading, writing = pipe
    output = Output(writing, 10.0, True)
    print("first", file=output, flush=True)
    assert os.read(reading, 100) == b"first\n"
    output.write("\udcff\n")
    output.flush()
    assert os.read(reading, 100) == b"\\udcff\n"


def test_a_pipe_that_nobody_reads_is_given_up_and_taken_up_again(pipe):
    reading, writing = pipe
    fill(writing)
    writer = PatientWriter(writing, 0.0, False)
    assert writer.write(b"waits") == 5
    assert writer.write(b"lost") == 4
    writer.urge(b"urgent")
    said = b""
    while not said.endswith(b"urgent"):
        said += os.read(reading, 65536)
    assert said.endswith(b".waitsurgent")
    writer.patience_s = 10.0
    writer.write(b"heard")
    assert os.read(reading, 100) == b"heard"


def waiting(writing):
    """A writer without a limit of time, and the thread in which it waits."""
    writer = PatientWriter(writing, float("inf"), True)
    thread = threading.Thread(target=writer.write, args=(b"waits",))
    thread.start()
    return writer, thread


def test_patience_may_be_lowered_while_somebody_waits(pipe):
    _, writing = pipe
    fill(writing)
    writer, thread = waiting(writing)
    writer.patience_s = 0.0
    thread.join(30.0)
    assert not thread.is_alive()


def test_results_that_cannot_be_written_are_told_once_messages_never(pipe):
    reading, writing = pipe
    os.close(reading)
    results = PatientWriter(writing, 10.0, True)
    with pytest.raises(BrokenPipeError):
        results.write(b"result")
    assert results.write(b"more") == 4
    assert PatientWriter(writing, 10.0, False).write(b"message") == 7


def test_a_pipe_that_does_not_block_is_waited_for(pipe):
    reading, writing = pipe
    fill(writing)
    os.set_blocking(writing, False)
    _, thread = waiting(writing)
    said = b""
    while not said.endswith(b"waits"):
        said += os.read(reading, 65536)
    thread.join(30.0)
    assert not thread.is_alive()


def test_a_line_that_a_signal_interrupted_is_written_once(pipe, monkeypatch):
    """Regression: the address of `open` came twice when Ctrl-C met the end of its print."""
    reading, writing = pipe
    output = Output(writing, 10.0, True)
    wait = output.writer._changed.wait

    def interrupted(timeout):
        monkeypatch.setattr(output.writer._changed, "wait", wait)
        raise KeyboardInterrupt

    monkeypatch.setattr(output.writer._changed, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        print("address", file=output, flush=True)
    print("more", file=output, flush=True)
    os.close(writing)
    assert os.read(reading, 100) == b"address\nmore\n"
