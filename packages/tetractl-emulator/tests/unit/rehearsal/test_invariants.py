"""Each invariant is broken by a record in which it does not hold, and by none in which it does."""

import math
from dataclasses import replace

import pytest
from support.paths import ROOT
from tetractl_emulator.rehearsal.day import Day, DayPlan
from tetractl_emulator.rehearsal.invariants import violations
from tetractl_emulator.rehearsal.truth import Truth

from tetractl.core.poses import Sight
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


DRIVES = [command(1.0 + k / 10, 20) for k in range(13)]
BUSY = {"kind": "host busy", "strength": 0.9, "fault": "busy", "seconds": 0.8, "at": 1.0}
GHOST = {"kind": "ghost turns", "strength": 0.9, "fault": "ghost", "robot": "green", "at": 0.1}
GHOST |= {"by": [0, 0], "turn": 0.01}
RUN = [at(1.0, "run"), at(1.0, "guard", state="run", reason=""), *DRIVES]
LOST = {"kind": "untracked", "strength": 0.95, "fault": "untracked", "robot": "green", "at": 1.0}
SEEN = at(2.0, "fault", phase="start", name="untracked", row=0)
STOPS = [command(2.31 + k / 50, 0, 0) for k in range(10)]
STOP = at(2.31, "guard", state="abort", reason="green is not tracked (0.30 s)")
LONG = [*RUN[:2], *[command(1.0 + k / 10, 20) for k in range(45)]]
TURNS = at(4.5, "fault", phase="start", name="ghost", row=0)
ENDS = at(5.5, "guard", state="abort", reason="green is not tracked (0.30 s)")
SEEN_GHOST = at(0.2, "fault", phase="start", name="ghost", row=0)
LATER = [at(1.5, "run"), at(1.5, "guard", state="run", reason=""), command(1.5, 20)]

LATE = {"kind": "frames late", "strength": 0.9, "fault": "late_frames", "by": 0.2, "at": 0.1}
OLD, END = at(0.1, "fault", phase="start", name="late_frames", row=0), truth_at(4.0)


def pressed(seconds):
    return at(seconds, "fault", phase="start", name="emergency", row=0)


def status_at(seconds, status):
    return truth_at(seconds) | {"status": [status, 0, 0]}


def out(beyond, together):
    """Exposures of a green that heads out of the arena, or towards blue, and is driven."""
    x, y, heading = (510.0, 800.0, math.pi) if beyond else (900.0, 1085.0, math.pi / 2)
    poses = [[x, y, heading], *STARTS[1:]]
    return [truth_at(1.0), *[truth_at(1.5 + k / 120, poses=poses) for k in range(60)]]


KEY = {"kind": "emergency stop", "strength": 0.5, "fault": "emergency", "at": 1.0}


def found(*events, fault=LOST, said=ERROR, code=1, left="", run=RUN, slower=0.0, setup=SETUP):
    events = sorted([*run, *events], key=lambda event: event["t_ns"])
    plan = DayPlan(1, {"actuator": {}}, [fault], "", slower=slower)
    day = Day(plan, events, code, said, None, left, 1.0)
    names = {one.name for one in violations(Truth(day, setup), LabLimits(), 0.25)}
    return names - {"no log"}


def test_a_good_end_breaks_nothing():
    assert not found(SEEN, STOP, *STOPS, truth_at(2.2, 180.0), truth_at(4.0))


@pytest.mark.parametrize(
    ("name", "events", "more"),
    [
        ("drives blind", [SEEN, STOP, command(2.1, 20, unseen=160.0)], {}),
        ("drives blind", [SEEN, STOP, command(2.1, 20) | {"unseen_ms": [95.0, 10.0, 10.0]}], {}),
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
        ("silent", [SEEN, STOP, at(2.9, "end"), truth_at(5.0)], {"run": RUN[:6]}),
        ("stops", [SEEN, STOP, *STOPS[:4], truth_at(4.0)], {}),
        ("stops", [SEEN, STOP, *[command(2.31 + k / 500, 0, 0) for k in range(10)], END], {}),
        ("begins blind", [OLD, truth_at(2.0)], {"fault": LATE, "run": LATER}),
        ("emergency not sent", [pressed(2.0), truth_at(4.0)], {"fault": KEY}),
        ("late", [SEEN, at(2.9, "guard", state="abort", reason="")], {"fault": BUSY}),
        ("late", [TURNS, ENDS], {"fault": GHOST | {"turn": 0.005}, "run": LONG}),
        ("late", [ENDS], {"slower": 0.25, "run": LONG}),
        ("emergency released", [status_at(2.0, 2), status_at(2.1, 0)], {}),
        ("obeys an old command", [STOP, status_at(2.4, 0), status_at(2.5, 1)], {}),
        ("begins in motion", [SEEN_GHOST], {"fault": GHOST, "run": LATER}),
        ("seen too rarely", [truth_at(1.0 + k / 60, unseen=200.0) for k in range(240)], {}),
        ("drives out", out(0.5, 0.0), {}),
        ("drives together", out(0.0, 0.5), {}),
        (
            "emergency released",
            [at(2.0, "fault", phase="start", name="emergency", row=0), command(2.1, 0, 0)],
            {"fault": KEY, "said": "error: trial 1: emergency stop by the operator\n"},
        ),
    ],
)
def test_an_invariant_is_broken(name, events, more):
    assert name in found(*events, **more)


SPOILT = {"kind": "frames damaged", "strength": 0.5, "fault": "bad_datagrams", "at": 1.0}


@pytest.mark.parametrize(("share", "wrong"), [(0.05, True), (0.1, False)])
def test_as_many_frames_are_called_damaged_as_were(share, wrong):
    begins = at(2.0, "fault", phase="start", name="bad_datagrams", row=0)
    said = "error: trial 1: 22 damaged camera frames within a second\n"
    names = found(begins, STOP, fault=SPOILT | {"share": share}, said=said)
    assert ("reason" in names) == wrong


@pytest.mark.parametrize(("burst", "wrong"), [(8, False), (14, True)])
def test_commands_are_sent_evenly(burst, wrong):
    most = [command(1.0 + k / 40, 20) for k in range(50)]
    more = [command(1.5 + k / 500, 20) for k in range(burst)]
    assert ("too often" in found(SEEN, STOP, *most, *more)) == wrong


@pytest.mark.parametrize(("robot", "wrong"), [("green", False), ("blue", True)])
def test_a_reason_names_the_robot_that_has_the_fault(robot, wrong):
    assert ("reason" in found(SEEN, STOP, fault=LOST | {"robot": robot})) == wrong


@pytest.mark.parametrize(
    ("state", "stopped", "wrong"),
    [("ready", 2.401, False), ("ready", 2.5, True), ("abort", 2.401, True)],
)
def test_a_plan_that_begins_in_the_tick_of_the_end_is_stopped_at_once(state, stopped, wrong):
    left = at(2.31, "guard", state=state, reason="green is not tracked (0.30 s)")
    events = (SEEN, left, *STOPS[:4], command(2.4, 20), command(stopped, 0, 0))
    assert ("drives after stop" in found(*events)) == wrong


@pytest.mark.parametrize(("again", "wrong"), [(0.5, False), (0.6, True)])
def test_stops_are_at_most_half_a_second_apart_while_one_robot_is_not_shown(again, wrong):
    hidden = [truth_at(2.4 + k / 20) | {"unseen_ms": [900.0, 10.0, 10.0]} for k in range(50)]
    stops = [command(2.31 + k * again, 0, 0) for k in range(6)]
    assert ("stops" in found(SEEN, STOP, *STOPS, *stops, *hidden)) == wrong


@pytest.mark.parametrize("x", [900.0, 900.9, 920.0])
def test_an_old_pose_that_is_right_on_a_cameras_grid_misleads_nobody(x):
    """A robot that stands within a step of the grid is shown by any frame, new or frozen."""
    moved = [[x, 800.0, 0.0], *STARTS[1:]]
    seen = [truth_at(1.0, unseen=0.0), truth_at(3.0, poses=moved, unseen=2000.0)]
    grid = replace(SETUP, sight=Sight(grid_mm=1.36, grid_rad=0.02))
    events = (SEEN, *seen, command(3.01, 20, unseen=2010.0))
    late = [*events, truth_at(3.6, poses=moved, unseen=2600.0), command(3.61, 20, unseen=2610.0)]
    assert "drives blind" in found(*events)
    assert ("drives blind" in found(*late, setup=grid)) == (x > 901.36)
