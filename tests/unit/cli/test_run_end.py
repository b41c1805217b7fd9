"""Tests of what `run` prints at its end, and of its exit code."""

import errno
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest
from testkit.batches import result

from tetractl.cli import trials
from tetractl.core.errors import Exit
from tetractl.run.batch import Report
from tetractl.run.interrupt import Interrupt


def end_interrupted(folder, report, number=signal.SIGINT, in_lab=False):
    """End a run of two trials that was interrupted by a signal."""
    interrupt = Interrupt()
    with interrupt.watch():
        signal.raise_signal(number)
    store = SimpleNamespace(folder=Path(folder), aborted=())
    return trials._conclude(report, [0, 1], interrupt, in_lab, store, as_json=False)


@pytest.mark.parametrize(
    ("number", "in_lab", "stopped"),
    [(signal.SIGTERM, True, True), (signal.SIGTERM, False, False), (signal.SIGINT, True, False)],
)
def test_after_lab_stop_robots_must_be_switched_on_before_a_run_continues(
    capsys, number, in_lab, stopped
):
    """Regression: the last line was about --resume alone, though every robot was latched."""
    assert end_interrupted("logs", Report(), number, in_lab) == Exit.INTERRUPTED
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.endswith("to continue, run the same command again with --out logs --resume")
    assert ("switch each off and on" in last) == stopped


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
