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

        not breakable  `make_breakable` makes the code breakable
        breakable      such a request raises KeyboardInterrupt: the code is not breakable any more,
                       unless a finaliser discards the error
    """

    def __init__(
        self, notice: Callable[[int], object] = lambda count: None, breaks_at: int = 2
    ) -> None:
        self.count = 0
        self.terminated = False  # whether a request was SIGTERM, which `tetractl lab stop` sends
        self.notice = notice  # called with `count` at each request, in the signal's handler
        self._breaks_at = breaks_at
        self._breakable = False

    @property
    def requested(self) -> bool:
        """Whether a signal or the user has asked the run to stop."""
        return self.count > 0

    def request(self) -> None:
        """Count a request to stop, and call `notice`.

        In breakable code, request number `breaks_at` and later requests raise KeyboardInterrupt.
        """
        self.count += 1
        self.notice(self.count)
        self._raise_if_due()

    def make_breakable(self) -> None:
        """Make all code breakable, until the next KeyboardInterrupt is raised."""
        self._breakable = True

    @contextmanager
    def watch(self, robots_move: bool = False) -> Iterator[None]:
        """Count signals inside the `with` block as requests to stop. Only for the main thread.

        If `robots_move` is True, the process must not be suspended, because it could not stop the
        robots then. Therefore Ctrl-Z is also a request, and using the terminal from the background
        suspends nothing.
        """
        handlers: dict[int, Handler] = dict.fromkeys(STOP_SIGNALS, self._on_signal)
        if robots_move and hasattr(signal, "SIGTSTP"):  # Windows suspends nothing
            handlers[signal.SIGTSTP] = self._on_signal
            handlers[signal.SIGTTIN] = signal.SIG_IGN
            handlers[signal.SIGTTOU] = signal.SIG_IGN
        previous_handlers = _install(handlers)
        previous_hook = sys.unraisablehook
        sys.unraisablehook = self.on_unraisable
        try:
            yield
        finally:
            sys.unraisablehook = previous_hook
            _install(previous_handlers)

    @contextmanager
    def breakable(self) -> Iterator[None]:
        """Let request number `breaks_at` raise KeyboardInterrupt inside the `with` block.

        If the block then raises another exception, this counts as the KeyboardInterrupt, because
        numba may convert a KeyboardInterrupt during an import or a compilation to another
        exception.
        """
        self._breakable = True
        try:
            self._raise_if_due()
            yield
        except Exception as error:
            if self.count >= self._breaks_at:
                raise KeyboardInterrupt from error
            raise
        finally:
            self._breakable = False

    def _raise_if_due(self) -> None:
        """Raise KeyboardInterrupt once, if the code is breakable and enough requests have come."""
        if self._breakable and self.count >= self._breaks_at:
            self._breakable = False
            raise KeyboardInterrupt

    def _on_signal(self, signal_number: int, frame: FrameType | None) -> None:
        self.terminated = self.terminated or signal_number == signal.SIGTERM
        self.request()

    def on_unraisable(self, lost: "sys.UnraisableHookArgs", /) -> None:
        """If a finaliser discarded the KeyboardInterrupt, let the next request raise it again.

        Other exceptions are reported as usual.
        """
        if issubclass(lost.exc_type, KeyboardInterrupt):
            self.make_breakable()
        else:
            sys.__unraisablehook__(lost)


@contextmanager
def interrupted_once(robots_move: bool = False) -> Iterator[None]:
    """Raise KeyboardInterrupt in the block at the first signal, and ignore later signals.

    No signal then interrupts the `finally` clauses that stop robots or restore a terminal.
    `robots_move` is passed to `Interrupt.watch`. Only for the main thread.
    """
    interrupt = Interrupt(breaks_at=1)
    interrupt.make_breakable()
    with interrupt.watch(robots_move):
        yield


def leave_on_signals(exit_code: int, before_exit: Callable[[], object] = lambda: None) -> None:
    """End the process immediately at the next signal.

    This is for code that has nothing to stop or to close. There, a KeyboardInterrupt during an
    import could be printed as a traceback and then ignored. Only for the main thread.

    Args:
        exit_code: Exit code of the process.
        before_exit: Called before the process ends.
    """
    _install(dict.fromkeys(STOP_SIGNALS, _ExitHandler(exit_code, before_exit)))
    SIGNAL_LISTENER.start()


class _ExitHandler:
    """A handler of signals that calls a function and ends the process at the first signal."""

    def __init__(self, exit_code: int, before_exit: Callable[[], object]) -> None:
        self._exit_code = exit_code
        self._before_exit = before_exit
        self._first_call = threading.Lock()

    def __call__(self, number: int, frame: FrameType | None = None) -> None:
        if self._first_call.acquire(blocking=False):
            self._before_exit()
            os._exit(self._exit_code)


class _SignalListener:
    """A thread that ends the process at a signal whose handler would end it.

    Python calls a handler only when the main thread returns from compiled code, which may take
    minutes. Signals that arrived before the handlers changed are forgotten: the main thread, which
    changes the handlers, has called or is now calling the handler for each of these signals.
    """

    def __init__(self) -> None:
        self._signal_socket: socket.socket | None = None  # a byte, its number, for each signal
        self._lock = threading.Lock()  # handlers do not change while one is looked up and called

    def start(self) -> None:
        """Start the thread, once.

        In a forked process, the signals would go to the parent's thread. Therefore, a forked
        process sends none.
        """
        if self._signal_socket is not None:
            return
        self._signal_socket, wakeup_socket = socket.socketpair()
        self._signal_socket.setblocking(False)
        wakeup_socket.setblocking(False)
        signal.set_wakeup_fd(wakeup_socket.detach(), warn_on_full_buffer=False)
        if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
            os.register_at_fork(after_in_child=self._end_in_child)
        threading.Thread(
            target=self._listen, args=(self._signal_socket,), name="signals", daemon=True
        ).start()

    @contextmanager
    def changing(self) -> Iterator[None]:
        """Allow handlers to be changed in the `with` block, and forget all signals up to its end.

        Only the main thread may use it.
        """
        with self._lock:
            yield
            if self._signal_socket is not None:
                with suppress(BlockingIOError):
                    while self._signal_socket.recv(1024):
                        pass

    def _listen(self, signals: socket.socket) -> None:
        while True:
            select.select([signals], [], [])
            with self._lock, suppress(BlockingIOError):  # `changing` has discarded it
                (number,) = signals.recv(1)
                handler = signal.getsignal(number)
                if isinstance(handler, _ExitHandler):
                    handler(number)

    def _end_in_child(self) -> None:
        signal.set_wakeup_fd(-1)
        self._signal_socket = None


SIGNAL_LISTENER = _SignalListener()


def ignore_signals() -> None:
    """Ignore all further signals.

    This function is called before the interpreter ends, which removes all other handlers.
    """
    _install(dict.fromkeys(STOP_SIGNALS, signal.SIG_IGN))


def _install(handlers: dict[int, Handler]) -> dict[int, Handler]:
    """Set signal handlers, and return the previous handlers, by signal number.

    Under `nohup`, SIGHUP stays ignored. Handlers that a program using tetractl has set are kept,
    except those of Ctrl-C and SIGTERM.
    """
    previous_handlers: dict[int, Handler] = {}
    with SIGNAL_LISTENER.changing():
        for signal_number, handler in handlers.items():
            current = signal.getsignal(signal_number)
            is_kept = signal_number == getattr(signal, "SIGHUP", None) and current == signal.SIG_IGN
            if signal_number not in (signal.SIGINT, signal.SIGTERM):
                is_kept |= callable(current) and current.__module__ != __name__
            if not is_kept and current is not None and handler is not None:
                previous_handlers[signal_number] = signal.signal(signal_number, handler)
    return previous_handlers
