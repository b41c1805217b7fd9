"""Passes one log to every command that reads logs, in this process."""

import shutil
from functools import cache
from pathlib import Path
from unittest import mock

import typer

from testkit.cli import Done, tetractl

COMMANDS = {
    "info": "info {log}",
    "info --json": "info {log} --json",
    "replay": "replay {log}",
    "plot": "plot {log} -o {out}/t.png",
    "stats": "stats {log}",
    "stats --csv": "stats {log} --format csv",
    "verify": "verify {log}",
    "recover": "recover {log} -o {out}/r.mcap",
}
TELL_ON_STDOUT = ("verify", "info", "info --json", "recover")

_parser = cache(typer.main.get_command)  # made for each call it takes longer than most commands


def call(command: str, log: Path, out: Path) -> Done:
    """Run a command in this process; a bug of it is raised."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    words = [word.format(log=log, out=out) for word in COMMANDS[command].split()]
    with mock.patch.object(typer.main, "get_command", _parser):
        return tetractl(out, *words)


def check(command: str, log: Path, out: Path) -> Done:
    """Run a command; AssertionError for output that a terminal would obey, or that is endless."""
    done = call(command, log, out)
    for line in (done.stdout + done.stderr).split("\n"):
        assert line.isprintable(), (command, line[:200])
    assert len(done.stdout) + len(done.stderr) < 1_000_000, command
    assert done.returncode in (0, 1, 2, 3), (command, done.returncode)
    assert done.returncode == 0 or done.stderr or command in TELL_ON_STDOUT
    return done
