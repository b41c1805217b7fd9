"""What `run` prints at its end, and its exit code."""

import errno
from pathlib import Path

from support.batches import result

from tetractl.cli import trials
from tetractl.core.errors import Exit
from tetractl.run.batch import Report


def end_interrupted(folder, report):
    """End a run of two trials that was interrupted."""
    return trials._conclude(report, [0, 1], True, Path(folder), as_json=False)


def test_a_folder_with_a_blank_is_quoted_in_the_command_that_continues(capsys):
    """Regression: the shell took it for two words."""
    assert end_interrupted("my logs", Report()) == Exit.INTERRUPTED
    assert "--out 'my logs' --resume" in capsys.readouterr().err.splitlines()[-1]


def test_statistics_that_cannot_be_written_are_said_of_an_interrupted_run_too(monkeypatch, capsys):
    """Regression: only a complete run said so."""
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(trials, "_print_statistics", lambda *_, **__: full)
    report = Report({("", 0): result([1.0, 2.0, 3.0])})
    assert end_interrupted("logs", report) == Exit.INTERRUPTED
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "error: the statistics were not written: No space left on device"
