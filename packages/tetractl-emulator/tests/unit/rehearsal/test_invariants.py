"""Each invariant is broken by a record in which it does not hold, and by none in which it does."""

import pytest
from support.paths import ROOT
from tetractl_emulator.rehearsal.day import Day, DayPlan
from tetractl_emulator.rehearsal.invariants import violations
from tetractl_emulator.rehearsal.truth import Truth

from tetractl.experiment.lab_section import LabLimits
from tetractl.experiment.load import load_spec

SETUP = load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml").experiment.setup
STARTS = [[900.0, 800.0, 0.0], [900.0, 1200.0, 0.0], [900.0, 1600.0, 0.0]]
STILL = [[0.0, 0.0]] * 3
ERROR = "error: trial 1: green is not tracked (0.30 s)\n"


def at(seconds, event, **facts):
    return {"t_ns": round(seconds * 1e9), "event": event, **facts}


def truth_at(seconds, speed=0.0, poses=STARTS, unseen=10.0):
    wheels = [[speed, speed], *STILL[1:]]
    return at(seconds, "truth", frame=1, poses=poses, wheels=wheels, unseen_ms=[unseen] * 3)


def command(seconds, count, flags=1, unseen=10.0):
    wheels = [[count, count], [0, 0], [0, 0]]
    return at(seconds, "command", flags=flags, wheels=wheels, unseen_ms=[unseen] * 3)


RUN = [at(1.0, "run"), at(1.0, "guard", state="run", reason=""), command(1.0, 20)]
LOST = {"kind": "untracked", "strength": 0.95, "fault": "untracked", "robot": "green", "at": 1.0}
SEEN = at(2.0, "fault", phase="start", name="untracked", row=0)
STOP = at(2.31, "guard", state="abort", reason="green is not tracked (0.30 s)")
KEY = {"kind": "emergency stop", "strength": 0.5, "fault": "emergency", "at": 1.0}


def found(*events, fault=LOST, said=ERROR, code=1, left=""):
    events = sorted([*RUN, *events], key=lambda event: event["t_ns"])
    day = Day(DayPlan(1, {}, [fault], ""), events, code, said, None, left, 1.0)
    names = {one.name for one in violations(Truth(day, SETUP), LabLimits(), 0.25)}
    return names - {"no log"}


def test_a_good_end_breaks_nothing():
    assert not found(SEEN, STOP, command(2.31, 0, 0), truth_at(2.2, 180.0), truth_at(4.0))


@pytest.mark.parametrize(
    ("name", "events", "more"),
    [
        ("drives blind", [SEEN, STOP, command(2.1, 20, unseen=160.0)], {}),
        ("drives after stop", [SEEN, STOP, command(2.4, 20)], {}),
        ("moves after stop", [SEEN, STOP, truth_at(3.4, 90.0)], {}),
        ("moves unseen", [SEEN, STOP, truth_at(2.2, 90.0, unseen=1100.0)], {}),
        ("enters", [SEEN, STOP, truth_at(2.2, poses=[[400.0, 800.0, 0.0], *STARTS[1:]])], {}),
        ("enters", [SEEN, STOP, truth_at(2.2, poses=[[1300.0, 1200.0, 0.0], *STARTS[1:]])], {}),
        ("late", [SEEN, at(2.6, "guard", state="abort", reason="")], {}),
        ("reason", [SEEN, STOP], {"said": "error: trial 1: the moon is full\n"}),
        ("exception", [SEEN, STOP], {"said": "error: trial 1: KeyError: 3\n"}),
        ("exit code", [SEEN, STOP], {"code": 0}),
        ("left behind", [SEEN, STOP], {"left": "a thread"}),
        ("hangs", [SEEN, STOP], {"code": -100}),
        (
            "emergency released",
            [at(2.0, "fault", phase="start", name="emergency", row=0), command(2.1, 0, 0)],
            {"fault": KEY, "said": "error: trial 1: emergency stop by the operator\n"},
        ),
    ],
)
def test_an_invariant_is_broken(name, events, more):
    assert name in found(*events, **more)
