import os
import signal

import pytest

from tetractl.run.interrupt import Interrupt


def test_only_a_second_request_breaks_and_only_what_is_breakable():
    interrupt = Interrupt()
    assert not interrupt.requested
    with interrupt.breakable():
        interrupt.request()
    assert interrupt.requested
    interrupt.request()  # outside: nothing is torn
    with pytest.raises(KeyboardInterrupt), interrupt.breakable():
        raise AssertionError("a second request was made already")


def test_a_second_request_breaks_what_is_under_way():
    interrupt = Interrupt()
    interrupt.request()
    reached = False
    with pytest.raises(KeyboardInterrupt), interrupt.breakable():
        reached = True
        interrupt.request()
    assert reached
    interrupt.request()  # nothing is breakable any more
    assert interrupt.count == 3


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_are_requests_while_watched_and_handlers_are_put_back(number):
    before = signal.getsignal(number)
    interrupt = Interrupt()
    with interrupt.watch():
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)
        assert interrupt.count == 2
    assert signal.getsignal(number) is before
