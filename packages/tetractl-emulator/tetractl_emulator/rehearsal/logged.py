"""Checks that the log contains each command that was sent, and each frame that was shown."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.poses import Floats
from tetractl_emulator.rehearsal.truth import RUN_FLAG, Truth, Violation, time_s

NOTED_S = 0.002  # from a transmission to its record: the poll of the wire
MUTE = ("unplug", "stuck_port", "stopped", "host_clock")  # nothing can be sent
FRAMES = 4  # frames in a row that may be missing though robots are shown
SHOWN_S = 0.025  # in three frames of 120 Hz a robot that is shown has been seen
STREAM = ("clock_jump", "clock_rate", "counter_back", "outdated", "bad_datagrams", "reordered")
FAULTY = ("other_version", "edit_mode", "twin_id", *MUTE)  # frames that are shown, and not taken


def logged(truth: Truth) -> Iterator[Violation]:
    """Yield each contradiction between a complete log and what truly happened.

    A log that is missing, damaged or without a result is not checked.
    """
    log = truth.trial
    if log is None or log.result is None or log.damage is not None:
        return
    if not truth.had_fault(*MUTE):
        yield from _commands(truth)
    if len(log.frames) and (np.diff(log.mocap_ns) <= 0).any():
        yield Violation("log", 0.0, "a frame is logged twice, or too late")
    if not truth.had_fault(*STREAM, *FAULTY):
        yield from _whole(truth, truth.logged_exposures.tolist())


def _commands(truth: Truth) -> Iterator[Violation]:
    """Check that the log has exactly the commands that were sent. Yield the first violation."""
    assert truth.trial is not None
    logged_s = np.array([command.sent_ns for command in truth.trial.commands]) / 1e9
    for command in truth.trial.commands:
        finding = _false_command(truth, command, logged_s)
        if finding:
            yield Violation("log", command.sent_ns / 1e9, finding)
            return
    driven_s = [time_s(command) for command in truth.commands if any(truth.driven_by(command))]
    stop_s = truth.trial.commands[-1].sent_ns / 1e9
    if driven_s and driven_s[-1] > stop_s + NOTED_S:
        yield Violation(
            "log", stop_s, "the last logged stop came before the robots were last driven"
        )
        return
    # a driver hears a last stop as its port is closed
    ends_s = max([*driven_s, *logged_s])
    sent_s = truth.commanded_s
    for at_s in sent_s[(sent_s > truth.steering_began_s) & (sent_s <= ends_s)].tolist():
        if not ((logged_s <= at_s) & (logged_s >= at_s - NOTED_S)).any():
            yield Violation("log", at_s, "lacks a command")
            return


def _false_command(truth: Truth, command: Command, logged_s: Floats) -> str:
    """Compare a logged command with the messages that were sent at its time.

    There may be several messages, one for each robot.

    Returns:
        How they differ, or "" if they agree.
    """
    at_s = command.sent_ns / 1e9
    is_noted = (truth.commanded_s >= at_s) & (truth.commanded_s <= at_s + NOTED_S)
    messages = [truth.commands[k] for k in np.flatnonzero(is_noted)]
    if not messages:
        return "the log has a command that was not sent"
    if command.action == Stop() and all(message["flags"] & RUN_FLAG for message in messages):
        return "the log has a stop where robots were driven"
    if (logged_s == at_s).sum() > len(messages):
        return "the log has a command twice"
    drives = [truth.driven_by(message) for message in messages]
    if isinstance(command.action, Steer) and not _reached(command.delivered, drives):
        return "the log has a robot driven that was not"
    return ""


def _reached(delivered: Sequence[bool], drives: Sequence[Sequence[bool]]) -> bool:
    """Check that every robot to which a command was delivered is driven by one of its messages.

    Each entry of `driven_by` is a message, and states for each robot whether it drives it. Without
    messages, nothing is checked and the result is True.
    """
    driven = [any(messages) for messages in zip(*drives, strict=False)]
    return all(drove for got, drove in zip(delivered, driven, strict=False) if got)


def _whole(truth: Truth, rows: list[int]) -> Iterator[Violation]:
    """Check that a frame is missing from the log only if the camera showed no robot in it.

    `rows` are the exposures of the logged frames, in order. Only the first gap is yielded, and gaps
    of up to FRAMES exposures are allowed.
    """
    for row, next_row in pairwise(rows):
        if next_row <= row + FRAMES:
            continue
        unseen_s = truth.unseen_s[row + 1 : next_row].min(axis=1)
        if (unseen_s < SHOWN_S).sum() >= FRAMES:
            lacking = next_row - row - 1
            yield Violation("log", float(truth.times_s[row]), f"lacks {lacking} frames")
            return
