"""Checks that a mistyped command prints one line and a hint, exits with a code, and no more."""

import shlex

from testkit.cli import tetractl


def refused_in_one_line(folder, code, row):
    """Run a row "command | message | hint" in a folder, and assert that it is refused.

    The error is one line that holds the message; the hint, if there is one, is one more line and
    begins as the row says. Nothing in the folder changes.
    """
    command, message, hint = (*map(str.strip, row.split("|")), "")[:3]
    before = contents(folder)
    done = tetractl(folder, *shlex.split(command))
    assert (done.returncode, done.stdout) == (code, "")
    lines = [line for line in done.stderr.splitlines() if not line.startswith("damaged: ")]
    hints = [line for line in lines[1:] if line.startswith(f"hint: {hint}")]
    assert lines[0].startswith("error: ") and message in lines[0], lines
    assert len(hints) == len(lines) - 1 <= 1
    assert hints or not hint
    assert "folder: ." not in done.stderr
    assert contents(folder) == before


def contents(folder):
    """Every path in a folder, and the bytes of every file."""
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


def command_of(row):
    """The command of a row, which names its test."""
    return row.partition(" |")[0]
