"""Runs the command line in this process, as nearly every test of a command needs."""

import contextlib
import io
import os
import signal
import subprocess
import sys
from typing import NamedTuple
from unittest import mock

from testkit.running import PATIENCE_S, TETRACTL, environment
from tetractl.cli.app import run_app
from tetractl.run.interrupt import STOP_SIGNALS


class Done(NamedTuple):
    """A command that has ended."""

    returncode: int
    stdout: str
    stderr: str

    def ok(self) -> "Done":
        """This, if the exit code is 0."""
        assert self.returncode == 0, self.stderr
        return self


def tetractl(folder, *words, env=None, stdin="") -> Done:
    """Run a command in a folder as a shell does, without a terminal; an unforeseen error is raised.

    What is about processes, pipes and signals themselves starts a process instead.
    """
    out = Text()
    err = Text()
    handlers = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    try:
        with (
            contextlib.chdir(folder),
            mock.patch.dict(os.environ, environment() | (env or {}), clear=True),
            mock.patch.object(sys, "argv", ["tetractl", *map(str, words)]),
            mock.patch.object(sys, "stdin", io.StringIO(stdin)),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            code = run_app()
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return Done(int(code), out.getvalue(), err.getvalue())


def process(folder, *words, env=None, **options) -> Done:
    """Run the installed command in a process of its own."""
    done = subprocess.run(
        [TETRACTL, *map(str, words)],
        cwd=folder,
        env=environment() | (env or {}),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        **options,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return Done(done.returncode, done.stdout, done.stderr)


class Text(io.TextIOWrapper):
    """A text stream in memory, with the bytes beneath it that a file has."""

    def __init__(self):
        super().__init__(io.BytesIO(), encoding="utf-8", write_through=True)

    def getvalue(self):
        return self.buffer.getvalue().decode()
