"""Tests that contradictions between a made-up log and the truth are found."""

from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_emulator.rehearsal.logged import logged

from tetractl.core.commands import Steer, Stop, Turn


def truth(commands=(), sent=(), began_s=0.0):
    """A day: what was logged and sent, with flags and the robots driven, and when the run began."""
    messages = [{"t_ns": at_ns, "flags": flags, "drives": drives} for at_ns, flags, drives in sent]
    log = SimpleNamespace(
        commands=[
            SimpleNamespace(sent_ns=at_ns, action=action, delivered=delivered)
            for at_ns, action, delivered in commands
        ],
        result="some",
        damage=None,
        frames=(),
    )
    return SimpleNamespace(
        trial=log,
        had_fault=lambda *names: False,
        commands=messages,
        commanded_s=np.array([message["t_ns"] for message in messages]) / 1e9,
        driven_by=lambda message: message["drives"],
        steering_began_s=began_s,
        logged_exposures=np.array([], int),
        faults=(),
    )


def findings(**day):
    return [violation.finding for violation in logged(truth(**day))]


# times [ns], flags and robots driven of a command to drive both robots, or one
AHEAD = (9, 1, [True, True])
STAND = (9, 1, [True, False])


@pytest.mark.parametrize(
    ("commands", "sent", "text"),
    [
        ([(9, Steer(0.0), (True, True))], [AHEAD], None),
        ([(9, Steer(0.0), (True, False))], [STAND], None),
        ([(9, Turn(0.0), (True, True))], [STAND], None),  # it faces there
        (
            [(9, Steer(0.0), (True, True))],
            [STAND],
            "the log says that a command reached a robot, but that robot was not driven",
        ),
        ([(9, Stop(), (True, True))], [(9, 0, [False, False])], None),
        (
            [(9, Stop(), (True, True))] * 2,
            [(9, 0, [False, False])],
            "the log contains a command twice, but it was sent once",
        ),
        ([(9, Stop(), (True, True))] * 2, [(9, 0, [False, False])] * 2, None),
    ],
)
def test_the_log_has_each_command_as_it_was_sent(commands, sent, text):
    assert findings(commands=commands, sent=sent) == ([text] if text else [])


def test_a_log_need_not_have_what_was_sent_before_its_run():
    """Regression: another program drove robots before, and a poll of the start was missed."""
    poll = (3, 4, [False, False])
    day = {"commands": [(9, Steer(0.0), (True, True))], "sent": [poll, AHEAD]}
    assert findings(**day, began_s=8e-9) == []
    assert findings(**day, began_s=2e-9) == ["the log lacks a command that was sent"]
