"""What a log must not say, on logs made up."""

from types import SimpleNamespace

import numpy as np
import pytest
from tetractl_emulator.rehearsal.logged import logged

from tetractl.core.commands import Note, Steer, Stop, Turn

FIVE = "5 control steps in a row were late"


def truth(late=(), notes=(), reason="", commands=(), sent=(), muted=True):
    """A day: how late its steps were [s], its notes, and what was logged and sent, with flags and
    the robots driven."""
    steps = [
        SimpleNamespace(
            observation=SimpleNamespace(received_ns=k * 10**8),
            command=SimpleNamespace(sent_ns=k * 10**8 + round(s * 1e9)),
        )
        for k, s in enumerate(late)
    ]
    events = [{"t_ns": at, "flags": flags, "driven": driven} for at, flags, driven in sent]
    log = SimpleNamespace(
        steps=steps,
        notes=[Note(k, "info", text) for k, text in enumerate(notes)],
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
        reason=reason,
        setup=SimpleNamespace(period_s=0.05, names=("blue", "red")),
        met=lambda *names: muted,
        of=lambda event: events,
        commanded=np.array([event["t_ns"] for event in events]) / 1e9,
        drives=lambda event: event["driven"],
        first=lambda event: 0.0,
        rows=(),
        faults=(),
    )


def said(**day):
    return [one.found for one in logged(truth(**day))]


@pytest.mark.parametrize("why", ["", ": red is slow"])
def test_late_steps_in_a_row_were_late_in_a_row(why):
    assert said(late=[0, 0, 0.06, 0.07, 0.06, 0.05], reason=FIVE + why) == []
    (text,) = said(late=[0, 0.06, 0.07, 0.01, 0.06], reason=FIVE + why)
    assert text.startswith("has a punctual step among them")
    silent = "5 control steps in a row were late: the controller gave no direction for 0.5 s"
    assert said(late=[0, 0, 0, 0, 0], reason=silent) == []


def test_a_robot_is_lost_once():
    assert said(notes=["red is lost", "blue is lost", "red is tracked again", "red is lost"]) == []
    twice = ["red is lost", "blue is lost", "red is lost"]
    assert said(notes=twice) == ["says twice that red is lost, or tracked"]


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
    assert said(commands=commands, sent=sent, muted=False) == ([text] if text else [])


@pytest.mark.parametrize(("other", "text"), [("blue", "says that it saw a robot"), ("red", None)])
def test_a_hidden_robot_is_not_seen_unless_it_is_swapped(other, text):
    day = truth()
    day.trial.frames, day.trial.mocap_ns = np.array([1, 2]), np.array([10**9, 2 * 10**9])
    day.trial.exposed_ns = np.repeat(day.trial.mocap_ns[:, None], 2, axis=1)
    day.trial.valid = np.ones((2, 2), bool)
    day.times, day.rows = np.array([1.0, 2.0]), (0, 1)
    hides = {"fault": "nan", "robot": "red"}, {"fault": "swap", "robot": "blue", "other": other}
    day.faults = [(0.5, 1.5, fault) for fault in hides]
    assert [one.found for one in logged(day)] == ([text] if text else [])
