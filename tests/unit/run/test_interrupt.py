import os
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest
from testkit.running import PATIENCE_S

from tetractl.run.interrupt import STOP_SIGNALS, Interrupt, interrupted_once


@contextmanager
def handled(number, how):
    """What a signal does meanwhile."""
    before = signal.signal(number, how)
    try:
        yield
    finally:
        signal.signal(number, before)


def test_only_a_second_request_breaks_and_only_what_is_breakable():
    interrupt = Interrupt()
    assert not interrupt.requested
    with interrupt.breakable():
        interrupt.request()
    assert interrupt.requested
    interrupt.request()  # outside: nothing is torn
    with pytest.raises(KeyboardInterrupt), interrupt.breakable():
        raise AssertionError("a second request was made already")
    interrupt.request()  # nothing is breakable any more
    assert interrupt.count == 3


def test_signals_are_all_that_end_a_process_and_can_be_caught():
    names = {"SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGALRM", "SIGABRT", "SIGXCPU"}
    assert {getattr(signal, name) for name in names} <= set(STOP_SIGNALS)
    not_handled = {"SIGKILL", "SIGSTOP", "SIGTSTP", "SIGSEGV", "SIGCHLD", "SIGWINCH", "SIGPIPE"}
    assert not {getattr(signal, name) for name in not_handled} & set(STOP_SIGNALS)


def test_the_first_signal_raises_and_the_cleaning_up_is_left_in_peace():
    cleaned = False
    with pytest.raises(KeyboardInterrupt), interrupted_once():
        try:
            signal.raise_signal(signal.SIGTERM)  # SIGHUP may be ignored, as by nohup
        finally:
            signal.raise_signal(signal.SIGINT)
            cleaned = True
    assert cleaned


def test_a_suspending_signal_is_a_request_only_where_robots_move():
    before = signal.getsignal(signal.SIGTSTP)
    interrupt = Interrupt()
    with interrupt.watch(robots_move=True):
        signal.raise_signal(signal.SIGTSTP)
        signal.raise_signal(signal.SIGTTOU)
    assert interrupt.count == 1
    with interrupt.watch():
        assert signal.getsignal(signal.SIGTSTP) is before


@pytest.mark.parametrize("how", [signal.SIG_IGN, signal.SIG_DFL])
def test_nohup_is_obeyed(how):
    interrupt = Interrupt()
    with handled(signal.SIGHUP, how), interrupt.watch():
        signal.raise_signal(signal.SIGHUP)
    assert interrupt.requested is (how == signal.SIG_DFL)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGQUIT])
def test_signals_are_requests_while_watched_and_handlers_are_put_back(number):
    """Regression: failed when the tests ran behind `&`, where SIGQUIT is ignored."""
    interrupt = Interrupt()
    with handled(number, signal.SIG_DFL):
        with interrupt.watch():
            os.kill(os.getpid(), number)
            os.kill(os.getpid(), number)
            assert interrupt.count == 2
        assert signal.getsignal(number) is signal.SIG_DFL


COMPILED = """
import sys
from numba import njit
import tetractl.cli.app


@njit(nogil=True)
def endless(x):
    while x > 0:
        x = x + 1 if x < 1e9 else 1.0
    return x


def run_app():
    endless(-1.0)
    print("compiled", flush=True)
    endless(1.0)


tetractl.cli.app.run_app = run_app
from tetractl.cli import main
main()
"""


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_process_in_compiled_code(number):
    """Regression: `track` did not obey SIGTERM, as Python calls no handler meanwhile."""
    command = [sys.executable, "-c", COMPILED]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "compiled\n"
        process.send_signal(number)
        try:
            assert process.wait(PATIENCE_S) == 130
        finally:
            process.kill()
        assert process.stderr.read() == "error: interrupted\n"


def test_breakable_code_is_broken_once():
    """Regression: of eight signals at once the third broke the code that stops the robots."""
    interrupt = Interrupt()
    stopped = False
    with pytest.raises(KeyboardInterrupt), interrupt.breakable():
        interrupt.request()
        try:
            interrupt.request()
        finally:
            interrupt.request()
            stopped = True
    assert stopped


def test_a_signal_is_taken_once():
    """Regression: a process was ended by a signal that a block before had taken, as the thread that
    listens heard of it after the block."""
    program = """
import os
import signal
from contextlib import suppress
from tetractl.run.interrupt import interrupted_once, leave_on_signals

leave_on_signals(3)
for _ in range(100):
    with suppress(KeyboardInterrupt), interrupted_once():
        os.kill(os.getpid(), signal.SIGTERM)
"""
    assert subprocess.run([sys.executable, "-c", program], timeout=PATIENCE_S).returncode == 0


def test_handlers_of_the_program_around_are_left_alone():
    rung = []
    interrupt = Interrupt()
    with handled(signal.SIGUSR1, lambda number, frame: rung.append(number)), interrupt.watch():
        signal.raise_signal(signal.SIGUSR1)
    assert (interrupt.count, rung) == (0, [signal.SIGUSR1])


def test_an_interruption_lost_in_a_finaliser_is_silent_and_raised_at_the_next(capsys):
    class Finalised:
        """Stands for an object during whose finaliser Ctrl-C is pressed."""

        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    interrupt = Interrupt()
    with interrupt.watch():
        interrupt.request()
        with pytest.raises(KeyboardInterrupt), interrupt.breakable():
            Finalised()
            assert interrupt.count == 2
            signal.raise_signal(signal.SIGINT)
    assert capsys.readouterr().err == ""


def test_signals_that_a_system_lacks_are_not_asked_for(monkeypatch):
    """Regression: a run with robots named SIGTSTP, which Windows does not have."""
    for name in ("SIGTSTP", "SIGTTIN", "SIGTTOU"):
        monkeypatch.delattr(signal, name)
    interrupt = Interrupt()
    with interrupt.watch(robots_move=True):
        signal.raise_signal(signal.SIGINT)
    assert interrupt.requested


@pytest.mark.parametrize("requests", [0, 1])
def test_an_error_in_breakable_code_stays_what_it_is_before_the_second_request(requests):
    interrupt = Interrupt()
    for _ in range(requests):
        interrupt.request()
    with pytest.raises(ValueError, match="its own"), interrupt.breakable():
        raise ValueError("its own")


def test_an_error_that_a_second_request_became_counts_as_the_interruption():
    """Numba may turn a KeyboardInterrupt while it compiles into another error."""
    interrupt = Interrupt()
    interrupt.request()
    with pytest.raises(KeyboardInterrupt) as caught, interrupt.breakable():
        try:
            interrupt.request()
        except KeyboardInterrupt:
            raise ValueError("compiling failed") from None
    assert isinstance(caught.value.__cause__, ValueError)


@pytest.mark.parametrize(
    ("numbers", "terminated"),
    [
        ([signal.SIGINT], False),
        ([signal.SIGTERM], True),
        ([signal.SIGTERM, signal.SIGINT], True),
        ([signal.SIGINT, signal.SIGTERM], True),
    ],
)
def test_whether_a_run_was_ended_by_sigterm_is_remembered(numbers, terminated):
    """`tetractl lab stop` sends it."""
    interrupt = Interrupt()
    with interrupt.watch():
        for number in numbers:
            signal.raise_signal(number)
    assert interrupt.terminated == terminated
    assert interrupt.count == len(numbers)


def test_every_request_is_told_with_its_number():
    told = []
    interrupt = Interrupt(told.append)
    for _ in range(3):
        interrupt.request()
    assert told == [1, 2, 3]
