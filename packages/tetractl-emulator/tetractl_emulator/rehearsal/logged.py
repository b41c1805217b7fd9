"""That the log says what happened: each command as it was sent, and each frame as it was shown."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from tetractl.core.commands import Steer, Stop
from tetractl_emulator.rehearsal.truth import RUN, Truth
from tetractl_emulator.rehearsal.violation import Violation

NOTED_S = 0.002  # from a transmission to its record: the poll of the wire
MUTE = ("unplug", "stuck_port", "stopped", "host_clock")  # nothing can be sent
FRAMES = 4  # frames in a row that may be missing though robots are shown
STREAM = ("clock_jump", "clock_rate", "counter_back", "outdated", "bad_datagrams", "reordered")
FAULTY = ("other_version", "edit_mode", "twin_id", *MUTE)  # frames that are shown, and not taken


def logged(truth: Truth) -> Iterator[Violation]:
    """Yield what a whole log says otherwise than it was."""
    log = truth.trial
    if log is None or log.result is None or log.damage is not None:
        return
    if not truth.met(*MUTE):
        yield from _commands(truth)
    if len(log.frames) and (np.diff(log.mocap_ns) <= 0).any():
        yield Violation("log", 0.0, "a frame comes twice, or late")
    if not truth.met(*STREAM, *FAULTY):
        yield from _whole(truth, [row for row in truth.rows if row is not None])


def _commands(truth: Truth) -> Iterator[Violation]:
    assert truth.trial is not None
    sent = truth.commanded
    said = np.array([one.sent_ns for one in truth.trial.commands]) / 1e9
    flags = [bool(e["flags"] & RUN) for e in truth.of("command")]
    drives = [truth.drives(e) for e in truth.of("command")]
    for at, one in zip(said.tolist(), truth.trial.commands, strict=True):
        noted = np.flatnonzero((sent >= at) & (sent <= at + NOTED_S)).tolist()
        if not noted:
            yield Violation("log", at, "has a command that was not sent")
            return
        if one.action == Stop() and all(flags[k] for k in noted):
            yield Violation("log", at, "says stop, and robots were driven")
            return
        if (said == at).sum() > len(noted):
            yield Violation("log", at, "has a command twice")
            return
        steers = isinstance(one.action, Steer)
        if steers and not _reached(one.delivered, [drives[k] for k in noted]):
            yield Violation("log", at, "says that a robot was driven that was not")
            return
    driven = [at for at, robots in zip(sent.tolist(), drives, strict=True) if any(robots)]
    stop_s = truth.trial.commands[-1].sent_ns / 1e9
    if driven and driven[-1] > stop_s + NOTED_S:
        yield Violation("log", stop_s, "its last stop came before robots were last driven")
        return
    ends_s = max([*driven, *said])  # a driver hears a last stop as its port is closed
    for at in sent[(sent > truth.first("run")) & (sent <= ends_s)].tolist():
        if not ((said <= at) & (said >= at - NOTED_S)).any():
            yield Violation("log", at, "lacks a command")
            return


def _reached(delivered: Sequence[bool], drove: Sequence[Sequence[bool]]) -> bool:
    """Return whether each robot to which a command was delivered was driven; each may have its own
    message.
    """
    return all(not got or any(d) for got, *d in zip(delivered, *drove, strict=False))


def _whole(truth: Truth, rows: list[int]) -> Iterator[Violation]:
    """Frames are missing only where the camera showed none."""
    for row, after in pairwise(rows):
        shown = truth.unseen[row + 1 : after].min(axis=1) if after > row + FRAMES else np.zeros(0)
        if (shown < 0.025).sum() >= FRAMES:
            yield Violation("log", float(truth.times[row]), f"lacks {after - row - 1} frames")
            return
