"""Checks that the log contains each command that was sent, and each frame that was shown."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from tetractl.core.commands import Command, Steer, Stop
from tetractl.core.poses import Floats
from tetractl_emulator.rehearsal.truth import RUN_FLAG, Truth, Violation, time_s

RECORD_DELAY_S = 0.002  # from a transmission to its record: the poll of the wire
MUTE = ("unplug", "stuck_port", "stopped", "host_clock")
"""Names of the faults during which our program cannot send anything."""
FRAMES = 4
"""Maximum number of successive frames that may be missing although the camera shows robots."""
SHOWN_S = 0.025
"""Time since its last exposure within which a robot counts as shown: three frames at 120 Hz [s]."""
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
        yield from _command_violations(truth)
    if len(log.frames) and (np.diff(log.mocap_ns) <= 0).any():
        yield Violation("log", 0.0, "the log contains a frame twice, or frames in a wrong order")
    if not truth.had_fault(*STREAM, *FAULTY):
        yield from _missing_frames(truth, truth.logged_exposures.tolist())


def _command_violations(truth: Truth) -> Iterator[Violation]:
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
    if driven_s and driven_s[-1] > stop_s + RECORD_DELAY_S:
        yield Violation(
            "log", stop_s, "the last logged stop came before the robots were last driven"
        )
        return
    # a driver hears a last stop as its port is closed
    ends_s = max([*driven_s, *logged_s])
    transmitted_s = truth.commanded_s
    for at_s in transmitted_s[
        (transmitted_s > truth.steering_began_s) & (transmitted_s <= ends_s)
    ].tolist():
        if not ((logged_s <= at_s) & (logged_s >= at_s - RECORD_DELAY_S)).any():
            yield Violation("log", at_s, "the log lacks a command that was sent")
            return


def _false_command(truth: Truth, command: Command, logged_s: Floats) -> str:
    """Compare a logged command with the messages that were sent at its time.

    There may be several messages, one for each robot.

    Returns:
        How they differ, or "" if they agree.
    """
    at_s = command.sent_ns / 1e9
    is_noted = (truth.commanded_s >= at_s) & (truth.commanded_s <= at_s + RECORD_DELAY_S)
    messages = [truth.commands[i] for i in np.flatnonzero(is_noted)]
    if not messages:
        return "the log contains a command that was not sent"
    if command.action == Stop() and all(message["flags"] & RUN_FLAG for message in messages):
        return "the log contains a stop command at a time when the robots were driven"
    if (logged_s == at_s).sum() > len(messages):
        return "the log contains a command twice, but it was sent once"
    drives = [truth.driven_by(message) for message in messages]
    if isinstance(command.action, Steer) and not _reached(command.delivered, drives):
        return "the log says that a command reached a robot, but that robot was not driven"
    return ""


def _reached(delivered: Sequence[bool], drives: Sequence[Sequence[bool]]) -> bool:
    """Check that each robot to which a command was delivered is driven by one of its messages.

    Args:
        delivered: For each robot, whether the log says that the command was delivered.
        drives: For each message of the command, which robots the message drives. If there are no
            messages, the result is True.
    """
    driven = [any(messages) for messages in zip(*drives, strict=False)]
    return all(
        was_driven
        for was_delivered, was_driven in zip(delivered, driven, strict=False)
        if was_delivered
    )


def _missing_frames(truth: Truth, rows: list[int]) -> Iterator[Violation]:
    """Check that a frame is missing from the log only if the camera showed no robot in it.

    Gaps of up to FRAMES exposures are allowed. Only the first longer gap is yielded.

    Args:
        truth: What truly happened.
        rows: The exposures of the logged frames, in the order of time.
    """
    for row, next_row in pairwise(rows):
        if next_row <= row + FRAMES:
            continue
        unseen_s = truth.unseen_s[row + 1 : next_row].min(axis=1)
        if (unseen_s < SHOWN_S).sum() >= FRAMES:
            n_missing = next_row - row - 1
            yield Violation("log", float(truth.times_s[row]), f"lacks {n_missing} frames")
            return
