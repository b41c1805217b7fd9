"""Handle Ctrl-C and other signals: the first ends a trial after its step, the second at once.

The robots are stopped in both cases. This applies to every signal that can be caught and ends a
process by default: Ctrl-C, SIGTERM, SIGHUP of a closed terminal, SIGQUIT, SIGUSR1, SIGALRM and
others. It does not apply to signals of a program fault, such as SIGSEGV, nor to SIGPIPE and
SIGXFSZ, which Python turns into errors.
"""

import os
import select
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

_FAULTS = {"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGPIPE", "SIGXFSZ"}
_HARMLESS = {"SIGCHLD", "SIGCLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGINFO"}
_SUSPENDING = {"SIGTSTP", "SIGTTIN", "SIGTTOU"}
_UNCAUGHT = _FAULTS | _HARMLESS | _SUSPENDING | {"SIGKILL", "SIGSTOP"}
_UNCAUGHT_HERE = {getattr(signal, name, None) for name in _UNCAUGHT}
STOP_SIGNALS = tuple(sorted(signal.valid_signals() - _UNCAUGHT_HERE))
"""The signals that are handled: those that can be caught and end a process, except faults."""

Handler = Callable[[int, FrameType | None], Any] | int | None


class Interrupt:
    """Counts requests to stop; raises KeyboardInterrupt only in code marked `breakable`.

    Request number `breaks_at`, or a later one, breaks off code once:

        not breakable  `let_break` makes the code breakable
        breakable      such a request raises KeyboardInterrupt: the code is not breakable any more,
                       unless a finaliser discards the error
    """

    def __init__(
        self, notice: Callable[[int], object] = lambda count: None, breaks_at: int = 2
    ) -> None:
        self.count = 0
        self.terminated = False  # whether SIGTERM was among them, as `tetractl lab stop` sends it
        self.notice = notice  # called with `count` at each request, in the signal's handler
        self._breaks_at = breaks_at
        self._breakable = False

    @property
    def requested(self) -> bool:
        """Whether a signal or the user has asked the run to stop."""
        return self.count > 0

    def request(self) -> None:
        """Count a request to stop, and call `notice`.

        Raises KeyboardInterrupt in breakable code from request number `breaks_at` on.
        """
        self.count += 1
        self.notice(self.count)
        self._break()

    def let_break(self) -> None:
        """Make all code breakable from now on, until a KeyboardInterrupt is raised."""
        self._breakable = True

    @contextmanager
    def watch(self, robots: bool = False) -> Iterator[None]:
        """Count signals inside the `with` block as requests to stop. Only for the main thread.

        If `robots` move, the process must not be suspended, because it could not stop them then.
        Therefore Ctrl-Z is also a request, and using the terminal from the background suspends
        nothing.
        """
        handlers: dict[int, Handler] = dict.fromkeys(STOP_SIGNALS, self._on_signal)
        if robots and hasattr(signal, "SIGTSTP"):  # Windows suspends nothing
            handlers[signal.SIGTSTP] = self._on_signal
            handlers[signal.SIGTTIN] = signal.SIG_IGN
            handlers[signal.SIGTTOU] = signal.SIG_IGN
        before = _install(handlers)
        unraisable = sys.unraisablehook
        sys.unraisablehook = self.on_unraisable
        try:
            yield
        finally:
            sys.unraisablehook = unraisable
            _install(before)

    @contextmanager
    def breakable(self) -> Iterator[None]:
        """Let request number `breaks_at` raise KeyboardInterrupt inside the `with` block.

        If the block then raises another exception, this counts as the KeyboardInterrupt, because
        numba may convert a KeyboardInterrupt during an import or a compilation to another
        exception.
        """
        self._breakable = True
        try:
            self._break()
            yield
        except Exception as error:
            if self.count >= self._breaks_at:
                raise KeyboardInterrupt from error
            raise
        finally:
            self._breakable = False

    def _break(self) -> None:
        """Raise KeyboardInterrupt once, if the code is breakable and enough requests have come."""
        if self._breakable and self.count >= self._breaks_at:
            self._breakable = False
            raise KeyboardInterrupt

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.terminated = self.terminated or number == signal.SIGTERM
        self.request()

    def on_unraisable(self, lost: "sys.UnraisableHookArgs", /) -> None:
        """If a finaliser discarded the KeyboardInterrupt, let the next request raise it again.

        Other exceptions are reported as usual.
        """
        if issubclass(lost.exc_type, KeyboardInterrupt):
            self.let_break()
        else:
            sys.__unraisablehook__(lost)


@contextmanager
def interrupted_once(robots: bool = False) -> Iterator[None]:
    """Raise KeyboardInterrupt in the block at the first signal, and ignore later signals.

    No signal then interrupts the `finally` clauses that stop robots or restore a terminal.
    `robots` is passed to `Interrupt.watch`. Only for the main thread.
    """
    once = Interrupt(breaks_at=1)
    once.let_break()
    with once.watch(robots):
        yield


def leave_on_signals(code: int, say: Callable[[], object] = lambda: None) -> None:
    """End the process immediately at the next signal, with the exit code `code`.

    `say` is called before. This is for code that has nothing to stop or to close, where a
    KeyboardInterrupt during an import could be printed as a traceback and then ignored. Main thread
    only.
    """
    _install(dict.fromkeys(STOP_SIGNALS, _Leave(code, say)))
    LISTENER.start()


class _Leave:
    """A handler of signals that calls a function and ends the process at the first signal."""

    def __init__(self, code: int, say: Callable[[], object]) -> None:
        self._code = code
        self._say = say
        self._once = threading.Lock()

    def __call__(self, number: int, frame: FrameType | None = None) -> None:
        if self._once.acquire(blocking=False):
            self._say()
            os._exit(self._code)


class _Listener:
    """A thread that ends the process at a signal whose handler would end it.

    Python calls a handler only when the main thread returns from compiled code, which may take
    minutes. Signals that arrived before the handlers changed are forgotten: the main thread, which
    changes the handlers, has called or is now calling the handler for each of these signals.
    """

    def __init__(self) -> None:
        self._signals: socket.socket | None = None  # a byte, its number, for each signal
        self._lock = threading.Lock()  # no handler changes between a signal and its handler

    def start(self) -> None:
        """Start the thread, once.

        In a forked process, the signals would go to the parent's thread. Therefore, a forked
        process sends none.
        """
        if self._signals is not None:
            return
        self._signals, tells = socket.socketpair()
        self._signals.setblocking(False)
        tells.setblocking(False)
        signal.set_wakeup_fd(tells.detach(), warn_on_full_buffer=False)
        if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
            os.register_at_fork(after_in_child=self._end_in_child)
        threading.Thread(
            target=self._listen, args=(self._signals,), name="signals", daemon=True
        ).start()

    @contextmanager
    def changing(self) -> Iterator[None]:
        """Allow handlers to be changed in the `with` block, and forget all signals up to its end.

        Only the main thread may use it.
        """
        with self._lock:
            yield
            if self._signals is not None:
                with suppress(BlockingIOError):
                    while self._signals.recv(1024):
                        pass

    def _listen(self, signals: socket.socket) -> None:
        while True:
            select.select([signals], [], [])
            with self._lock, suppress(BlockingIOError):  # it was forgotten
                (number,) = signals.recv(1)
                handler = signal.getsignal(number)
                if isinstance(handler, _Leave):
                    handler(number)

    def _end_in_child(self) -> None:
        signal.set_wakeup_fd(-1)
        self._signals = None


LISTENER = _Listener()


def ignore_signals() -> None:
    """Ignore all signals from now on.

    This is called before the interpreter ends, which removes all other handlers.
    """
    _install(dict.fromkeys(STOP_SIGNALS, signal.SIG_IGN))


def _install(handlers: dict[int, Handler]) -> dict[int, Handler]:
    """Set handlers of signals, and return the previous handlers.

    Under `nohup`, SIGHUP stays ignored. Handlers that a program using tetractl has set are kept,
    except those of Ctrl-C and SIGTERM.
    """
    before: dict[int, Handler] = {}
    with LISTENER.changing():
        for number, handler in handlers.items():
            now = signal.getsignal(number)
            stays = number == getattr(signal, "SIGHUP", None) and now == signal.SIG_IGN
            if number not in (signal.SIGINT, signal.SIGTERM):
                stays |= callable(now) and now.__module__ != __name__
            if not stays and now is not None and handler is not None:
                before[number] = signal.signal(number, handler)
    return before
