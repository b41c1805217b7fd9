"""What a log must not say, on logs made up."""

from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_emulator.rehearsal.logged import logged

from tetractl.core.commands import Steer, Stop, Turn


def truth(commands=(), sent=()):
    """A day: what was logged and sent, with flags and the robots driven."""
    events = [{"t_ns": at, "flags": flags, "driven": driven} for at, flags, driven in sent]
    log = SimpleNamespace(
        commands=[
            SimpleNamespace(sent_ns=at, action=action, delivered=delivered)
            for at, action, delivered in commands
        ],
        result="some",
        damage=None,
        frames=(),
    )
    return SimpleNamespace(
        trial=log,
        met=lambda *names: False,
        of=lambda event: events,
        commanded=np.array([event["t_ns"] for event in events]) / 1e9,
        drives=lambda event: event["driven"],
        first=lambda event: 0.0,
        rows=(),
        faults=(),
    )


def said(**day):
    return [one.found for one in logged(truth(**day))]


AHEAD, STAND = (9, 1, [True, True]), (9, 1, [True, False])


@pytest.mark.parametrize(
    ("commands", "sent", "text"),
    [
        ([(9, Steer(0.0), (True, True))], [AHEAD], None),
        ([(9, Steer(0.0), (True, False))], [STAND], None),
        ([(9, Turn(0.0), (True, True))], [STAND], None),  # it faces there
        ([(9, Steer(0.0), (True, True))], [STAND], "says that a robot was driven that was not"),
        ([(9, Stop(), (True, True))], [(9, 0, [False, False])], None),
        ([(9, Stop(), (True, True))] * 2, [(9, 0, [False, False])], "has a command twice"),
        ([(9, Stop(), (True, True))] * 2, [(9, 0, [False, False])] * 2, None),
    ],
)
def test_the_log_has_each_command_as_it_was_sent(commands, sent, text):
    assert said(commands=commands, sent=sent) == ([text] if text else [])
