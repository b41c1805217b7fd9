"""What the observer of a rehearsal derives from recorded events, without any code of the guard."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.path import Path as Outline
from testkit.emulator.made_days import at, give_log
from testkit.paths import ROOT
from tetractl_emulator.fault_rows import FRAME_S
from tetractl_emulator.process import CONTINUE_NS
from tetractl_emulator.rehearsal.day import DayOutcome
from tetractl_emulator.rehearsal.day_plan import DayPlan
from tetractl_emulator.rehearsal.truth import (
    EXPOSURE_MATCH_S,
    NO_EXPOSURE,
    TimeSpan,
    Truth,
    distances_to_shape,
    nearest_exposures,
)

from tetractl.core.clock import SECOND
from tetractl.core.shape import Shape
from tetractl.spec.lab_section import LabLimits
from tetractl.spec.load import load_spec

SETUP = load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml").experiment.setup
WATCHDOG_S = 0.25
places = st.floats(-50, 50)


def truth_of(events, faults=(), output=""):
    plan = DayPlan(1, {"actuator": {}}, [dict(fault) for fault in faults])
    outcome = DayOutcome(plan, sorted(events, key=lambda e: e["t_ns"]), 0, output, None, "", 1.0)
    return Truth(outcome, SETUP, LabLimits(), WATCHDOG_S)


def exposure(seconds, **facts):
    nowhere = {"poses": [[0.0, 0.0, 0.0]] * 3, "unseen_ms": [0.0] * 3, "frame": 1}
    return at(seconds, "truth", **nowhere | facts)


def guard(seconds, state):
    return at(seconds, "guard", state=state)


@pytest.mark.parametrize(
    ("output", "names"),
    [
        ("error: a fault; this robot still moves: green: switch it off", {"green"}),
        ("error: these robots still move: green, red: switch them off", {"green", "red"}),
        ("error: the camera has not seen this robot stand still: red: look at it", {"red"}),
        ("the cameras do not show that the robots stand still: late: red", set(SETUP.names)),
        ("green stands still although it is sent a direction", set()),
    ],
)
def test_the_robots_that_a_run_names_at_its_end_are_known(output, names):
    assert truth_of([], output=output).robots_named_at_end == names


CORNERS = {
    "triangle": [[0, 0], [30, 5], [10, 25]],
    "square": [[-20, -20], [20, -20], [20, 20], [-20, 20]],
    "concave": [[0, 0], [40, 0], [40, 30], [20, 10], [0, 30]],
}


@pytest.mark.parametrize("corners", CORNERS.values(), ids=CORNERS)
@given(x=places, y=places, turn=st.floats(0, math.tau))
def test_the_distance_to_a_polygon_is_that_to_its_nearest_edge_and_negative_inside(
    corners, x, y, turn
):
    """Turned by any angle, and compared with dots on the edges 0.15 mm apart."""
    turned = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    polygon = np.array(corners, float) @ turned
    share = np.linspace(0, 1, 401)[:, None]
    following = np.roll(polygon, -1, axis=0)
    dots = np.concatenate([a + share * (b - a) for a, b in zip(polygon, following, strict=True)])
    distance = float(distances_to_shape(Shape(polygon), np.array([x]), np.array([y]))[0])
    assert abs(distance) == pytest.approx(np.hypot(*(dots - (x, y)).T).min(), abs=0.08)
    if abs(distance) > 0.1:
        assert (distance < 0) == Outline(polygon).contains_point((x, y))


@given(x=places, y=places, radius=st.floats(0, 20))
def test_a_radius_makes_a_shape_nearer_by_as_much(x, y, radius):
    x, y = np.array([x]), np.array([y])
    disc = distances_to_shape(Shape(np.array([[3.0, -4.0]]), radius), x, y)
    assert disc == pytest.approx(np.hypot(x - 3, y + 4) - radius)
    corners = np.array(CORNERS["square"], float)
    assert distances_to_shape(Shape(corners, radius), x, y) == pytest.approx(
        distances_to_shape(Shape(corners), x, y) - radius
    )


def test_a_picture_shows_the_nearest_exposure_if_one_is_near():
    exposures_s = np.array([0.0, 0.1, 0.2, 0.3])
    stamps_s = np.array([0.1 + 0.9 * EXPOSURE_MATCH_S, 0.15, 0.2 - 0.9 * EXPOSURE_MATCH_S, 9.0])
    assert nearest_exposures(stamps_s, exposures_s, []).tolist() == [1, NO_EXPOSURE, 2, NO_EXPOSURE]


def test_a_picture_read_while_the_program_was_suspended_shows_none_that_is_known():
    exposures_s = np.array([0.0, 0.1, 0.2, 0.3])
    suspended = [TimeSpan(0.05, 0.15), TimeSpan(0.25, 0.35)]
    assert nearest_exposures(exposures_s, exposures_s, suspended).tolist() == [
        0,
        NO_EXPOSURE,
        2,
        NO_EXPOSURE,
    ]


def test_the_process_ends_a_moment_before_the_emulation():
    truth = truth_of([exposure(1.0), exposure(9.0)])
    assert truth.process_ended_s == pytest.approx(9.0 - CONTINUE_NS / SECOND)
    assert truth_of([]).process_ended_s == 0.0


def test_a_command_acts_until_the_next_one_or_the_watchdog():
    commands = [at(t, "command", flags=1, wheels=[]) for t in (1.0, 1.1, 5.0)]
    truth = truth_of([*commands, exposure(5.1 + CONTINUE_NS / SECOND)])
    assert truth.acting_s == pytest.approx([0.1, WATCHDOG_S, 0.1])


@pytest.mark.parametrize(
    ("command", "drives"),
    [
        ({"flags": 1, "wheels": [[0, 5], [-5, 0], [0, 0]]}, [True, True, False]),
        ({"flags": 0, "wheels": [[5, 5]] * 3}, [False] * 3),
        ({"flags": 2, "wheels": [[5, 5]] * 3}, [False] * 3),
        ({"flags": 1}, []),
        ({"flags": 0, "drives": [True, False, True]}, [True, False, True]),
    ],
)
def test_a_command_drives_a_robot_if_it_may_run_and_a_wheel_turns(command, drives):
    truth = truth_of([at(1.0, "command", **command)])
    assert truth.driven_by(truth.commands[0]) == drives
    assert truth.stop_commands_s == ([] if any(drives) else [1.0])


@pytest.mark.parametrize(
    ("states", "spans", "ended_s"),
    [
        ([(1, "wait"), (2, "run"), (3, "hold"), (4, "run"), (5, "ready")], [(2, 5)], 5),
        ([(2, "run"), (3, "wait"), (4, "run"), (6, "abort")], [(2, 3), (4, 6)], 6),
        ([(2, "run")], [(2, 9)], math.inf),
        ([(2, "run"), (2, "abort")], [], 2),
        ([(1, "wait"), (2, "abort")], [], 2),
        ([(1, "wait")], [], math.inf),
    ],
)
def test_robots_may_be_driven_while_the_guard_runs_or_holds(states, spans, ended_s):
    events = [guard(seconds, state) for seconds, state in states]
    truth = truth_of([*events, exposure(9.0 + CONTINUE_NS / SECOND)])
    assert [(span.began_s, span.ended_s) for span in truth.driven_spans] == spans
    assert truth.driving_ended_s == ended_s
    assert truth.undriven_from_s == ended_s


def test_a_kill_ends_driving_if_it_comes_first():
    kill = {"kind": "killed", "fault": "signal", "signal": "KILL", "at": 3.0}
    start = at(3.0, "fault", phase="start", name="signal", row=0)
    truth = truth_of([guard(2.0, "run"), start, guard(5.0, "abort")], [kill])
    assert truth.was_killed
    assert (truth.undriven_from_s, truth.driving_ended_s) == (3.0, 5.0)


def test_faults_are_visible_from_their_start_to_their_end_and_have_their_own_fields():
    late = {"kind": "late", "fault": "late_frames", "by": 0.2, "at": 4.0}
    later = {"kind": "later", "fault": "reordered", "by": 0.3, "at": 2.0}
    never = {"kind": "never", "fault": "busy", "seconds": 7.0, "at": 9.0}
    events = [
        at(2.0, "fault", phase="start", row=0),
        at(4.0, "fault", phase="start", row=1),
        at(5.0, "fault", phase="end", row=1),
    ]
    truth = truth_of(events, [late, later, never])
    spans = {fault.variant: (fault.span.began_s, fault.span.ended_s) for fault in truth.faults}
    assert spans == {"later": (2.0, math.inf), "late": (4.0, 5.0)}
    assert truth.longest_delay_s == pytest.approx(0.5)
    assert truth.had_fault("reordered")
    assert not truth.had_fault("busy")


def test_wheels_time_unseen_and_status_of_an_exposure_are_those_of_each_robot():
    first = exposure(
        1.0, wheels=[[-3.0, 2.0], [0, 0], [1, 4]], unseen_ms=[5.0, 0.0, 250.0], status=[1, 2, 5]
    )
    truth = truth_of([first, exposure(2.0, unseen_ms=[7.0])])  # one of another number of cells
    assert truth.wheel_speed_mm_s.tolist() == [[3, 0, 4], [0, 0, 0]]
    assert truth.unseen_s.tolist() == [[0.005, 0, 0.25], [0, 0, 0]]
    assert truth.has_status(1).tolist() == [[True, False, True], [False] * 3]
    assert truth.has_status(4).tolist() == [[False, False, True], [False] * 3]


@pytest.mark.parametrize(
    ("x", "y", "outside_mm"),
    [
        (SETUP.arena.left + 1, SETUP.arena.bottom + 1, 0.0),
        (SETUP.arena.left - 10, SETUP.arena.bottom + 1, 10.0),
        (SETUP.arena.right + 20, SETUP.arena.top + 10, 20.0),
        (SETUP.arena.right - 1, SETUP.arena.bottom - 30, 30.0),
        (1300.0, 1200.0, 100.0 + SETUP.body_radius),  # the middle of the obstacle
    ],
)
def test_a_robot_is_outside_by_its_greatest_excess(x, y, outside_mm):
    outside = truth_of([exposure(1.0, poses=[[x, y, 0.0]] * 3)]).outside_mm
    assert outside == pytest.approx(np.full((1, 3), outside_mm), abs=1e-6)


FASTEST = float(SETUP.speed.max())


@pytest.mark.parametrize(("off_mm_s", "hidden"), [(-0.5, True), (0.5, False)])
def test_a_ghost_looks_true_up_to_what_the_wheels_of_the_fastest_robot_may_be_off(off_mm_s, hidden):
    """Its speed may be off by `wheel_error`, and poses seem to move by 5 mm/s by their noise."""
    setup = replace(SETUP, speed=np.array([FASTEST, FASTEST / 2, FASTEST / 4]))
    unit_mm = setup.metres * 1000
    speed_mm_s = LabLimits().wheel_error * FASTEST * unit_mm + 5.0 + off_mm_s
    ghost = {"kind": "ghost", "fault": "ghost", "by": [0.0, speed_mm_s * FRAME_S], "at": 1.0}
    truth = truth_of([at(1.0, "fault", phase="start", row=0)], [ghost])
    truth.setup = setup
    assert truth.false_poses_look_true is hidden


def accepted_x(result, valid=((True, True, True), (True, True, True))):
    """x of green [mm] as accepted at four exposures, of which the second and third are logged."""
    rows = [exposure(k / 100, frame=k) for k in (1, 2, 3, 4)]
    truth = truth_of(rows)
    mocap = np.array([[[1.0, 0, 0]] * 3, [[2.0, 0, 0]] * 3])
    mocap[~np.array(valid)] = np.nan
    give_log(
        truth,
        result=result,
        frames=np.array([2, 3]),
        mocap=mocap,
        mocap_ns=np.array([20_000_000, 30_000_000]),
        valid=np.array(valid),
    )
    return (truth.accepted_poses[:, 0, 0] / truth.unit_mm).tolist()


def test_the_newest_accepted_pose_is_kept_to_the_end_of_the_log():
    nan = pytest.approx(math.nan, nan_ok=True)
    assert accepted_x("complete") == [nan, 1.0, 2.0, 2.0]
    assert accepted_x(None) == [nan, 1.0, 2.0, nan]  # nothing is known after it
    lost = ((True, True, True), (False, True, True))
    assert accepted_x("complete", lost) == [nan, 1.0, 1.0, 1.0]
