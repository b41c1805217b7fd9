"""Tests of each invariant with made-up days: those that violate it, and those that do not."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.emulator.made_days import at, give_log
from testkit.paths import ROOT
from tetractl_emulator.rehearsal.day import DayOutcome
from tetractl_emulator.rehearsal.day_plan import DayPlan
from tetractl_emulator.rehearsal.invariants import INVARIANTS, violations
from tetractl_emulator.rehearsal.truth import Truth

from tetractl.core.commands import Steer, Stop, Turn
from tetractl.core.plan import Outcome
from tetractl.core.poses import Sight
from tetractl.spec.lab_section import LabLimits
from tetractl.spec.load import load_spec

SETUP = load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml").experiment.setup
STARTS = [[900.0, 800.0, 0.0], [900.0, 1200.0, 0.0], [900.0, 1600.0, 0.0]]
ERROR = "error: trial 1: green is not tracked (0.30 s)\n"


def truth_at(seconds, speed=0.0, poses=STARTS, unseen=(10.0, 10.0, 10.0), status=(0, 0, 0)):
    wheels = [[speed, speed], [0.0, 0.0], [0.0, 0.0]]
    return at(
        seconds,
        "truth",
        frame=round(seconds * 120),
        poses=poses,
        wheels=wheels,
        unseen_ms=list(unseen),
        status=list(status),
    )


def command(seconds, count, flags=1, unseen=(10.0, 10.0, 10.0)):
    wheels = [[count, count], [0, 0], [0, 0]]
    return at(seconds, "command", flags=flags, wheels=wheels, unseen_ms=list(unseen))


def starts(seconds):
    return at(seconds, "fault", phase="start", name="", row=0)


LOST = {"kind": "untracked", "fault": "untracked", "robot": "green", "at": 1.0}
KEY = {"kind": "emergency stop", "fault": "emergency", "at": 1.0}
PRESSED = at(2.0, "fault", phase="start", name="emergency", row=0)
GHOST = {"kind": "ghost turns", "fault": "ghost", "robot": "green", "at": 0.1}
GHOST |= {"by": [0, 0], "turn": 0.01}
FREEZES = {"kind": "frames frozen", "fault": "freeze", "at": 1.0}
RUN = [at(1.0, "run"), at(1.0, "guard", state="run", reason="")]
DRIVES = [command(1.0 + k / 10, 20) for k in range(13)]
STOPS = [command(2.31 + k / 50, 0, 0) for k in range(10)]
ABORT = at(2.31, "guard", state="abort", reason="green is not tracked (0.30 s)")
END = truth_at(5.0)
GOOD = [*RUN, *DRIVES, starts(2.0), ABORT, *STOPS, truth_at(2.2, 180.0), END]


def day(events, fault=LOST, said=ERROR, code=1, leftovers="", setup=SETUP):
    """A day of such events without a log."""
    plan = DayPlan(1, {"actuator": {}}, [{"right": "not tracked|emergency stop", **fault}])
    in_order = sorted(events, key=lambda event: event["t_ns"])
    return Truth(
        DayOutcome(plan, in_order, code, said, None, leftovers, 1.0), setup, LabLimits(), 0.25
    )


def broken(events, **more):
    """Return the invariants that a day without a log breaks, but that a log has to be there."""
    return {violation.name for violation in violations(day(events, **more))} - {"log"}


def test_a_good_end_breaks_nothing():
    assert not broken(GOOD)


SEEN_SELDOM = [
    truth_at(1.0 + k / 60, unseen=(200.0, 10.0, 10.0) if k % 5 else (10.0, 10.0, 10.0))
    for k in range(300)
]


@pytest.mark.parametrize(
    ("events", "wrong"),
    [
        ([*GOOD, command(2.1, 20, unseen=(120.0, 10.0, 10.0))], False),
        ([*GOOD, command(2.1, 20, unseen=(260.0, 10.0, 10.0))], True),
        ([*GOOD, command(2.1, 20, unseen=(10.0, 10.0, 260.0))], False),  # one that stands
        ([*GOOD, command(2.1, 20, unseen=(10.0, 10.0, 460.0))], True),
        ([*RUN, command(1.0, 20, unseen=(60.0, 10.0, 10.0)), END], True),  # until its watchdog
        ([*RUN, *SEEN_SELDOM, at(5.5, "end"), truth_at(6.5)], True),
    ],
)
def test_no_robot_is_driven_blind(events, wrong):
    assert ("driven blind" in broken(events)) == wrong


@pytest.mark.parametrize(
    ("height", "at_s", "wrong"), [(200.0, 2.1, False), (200.0, 2.3, True), (95.0, 2.3, False)]
)
def test_a_robot_that_is_lifted_is_not_shown_though_it_is_tracked(height, at_s, wrong):
    lifted = {"kind": "lifted", "fault": "lifted", "robot": "green", "height": height, "at": 1.0}
    events = [*RUN, starts(2.0), command(at_s, 20), command(at_s + 0.02, 0, 0), END]
    assert ("driven blind" in broken(events, fault=lifted)) == wrong


WITHOUT_RESULT = None
WITH_RESULT = SimpleNamespace()


@pytest.mark.parametrize(
    ("sent_s", "result", "facing", "wrong"),
    [
        (1.6, WITH_RESULT, None, False),
        (1.4, WITH_RESULT, None, True),
        (1.4, WITHOUT_RESULT, None, False),
        (1.1, WITH_RESULT, 0.5, False),
        (0.9, WITH_RESULT, 0.5, True),
    ],
)
def test_no_robot_is_driven_without_a_direction(sent_s, result, facing, wrong):
    """Regression: what a log that a full disk broke off no longer has counted as not sent; and a
    turn on the spot, which lasts 0.5 s, as if it were a direction for one period."""
    truth = day(GOOD)
    give_log(truth, steps=[step(sent_s, sent_s, facing)], result=result)
    assert breaks(0, "driven blind", truth) == wrong


@pytest.mark.parametrize(
    ("events", "fault"),
    [
        ([*GOOD, truth_at(3.4, 90.0)], LOST),
        ([*GOOD, command(2.6, 20)], LOST),
        ([*RUN, *DRIVES, starts(2.0), ABORT, *STOPS[:2], END], LOST),
        ([*GOOD, truth_at(2.0, status=(2, 0, 0)), truth_at(2.1)], LOST),
        ([*GOOD, truth_at(2.4), truth_at(2.5, status=(1, 0, 0))], LOST),
        ([*GOOD, *(truth_at(2.35 + k / 10, unseen=(900, 10, 10)) for k in range(20))], LOST),
        ([*RUN, *DRIVES, PRESSED, END], KEY),
        ([*RUN, PRESSED, command(2.0, 0, 2), command(2.1, 0, 0), END], KEY),
        ([at(2.0, "run"), starts(0.5), END], GHOST),
    ],
)
def test_robots_rest_after_a_stop(events, fault):
    assert "not at rest" in broken(events, fault=fault)


SENDER = {"kind": "sender as robots stop", "fault": "driven_elsewhere", "at": 0.0}
SENDER |= {"counts": [20, 20], "rate": 100.0}
NAMED = (
    "error: trial 1: green is not tracked (0.30 s); this robot still moves: green: switch it off\n"
)


def driven_on(held, unseen=(10.0, 10.0, 10.0)):
    """A day on which green is driven from the end on, until the process ends at 8 s or after."""
    rows = [truth_at(2.4 + k / 60, 180.0, unseen=unseen) for k in range(338)]
    after = [truth_at(8.05 + k / 60, 0.0 if held else 180.0) for k in range(58)]
    return [*RUN, *DRIVES, starts(2.3), ABORT, *STOPS, *rows, *after]


@pytest.mark.parametrize(
    ("held", "said", "more", "wrong"),
    [
        (True, ERROR, {}, False),
        (False, ERROR, {}, True),
        (False, NAMED, {}, True),  # it could have been held
        (False, NAMED, {"unseen": (900.0, 10.0, 10.0)}, False),
        (False, ERROR, {"unseen": (900.0, 10.0, 10.0)}, True),
    ],
)
def test_no_robot_is_left_driving_by_another_program_and_each_that_is_is_named(
    held, said, more, wrong
):
    """Regression: what another program drove after a trial was excused."""
    events = driven_on(held, **more)
    found = [v for v in violations(day(events, fault=SENDER, said=said)) if "left dr" in v.finding]
    assert bool(found) == wrong


@pytest.mark.parametrize(("speed_mm_s", "wrong"), [(1.0, False), (2.0, True)])
def test_wheels_stand_once_the_slowest_have_rolled_from_1_m_s_to_1_mm_s(speed_mm_s, wrong):
    """At 3.4 s, 1.1 s after the end: a command comes within 0.05 s, the watchdog has 0.25 s, and
    to roll takes 0.55 s."""
    assert ("not at rest" in broken([*GOOD, truth_at(3.4, speed_mm_s)])) == wrong


CREEPS = GHOST | {"turn": 0.002}  # by 0.24 rad/s


@pytest.mark.parametrize(("again_s", "wrong"), [((2.9, 3.3, 3.7), False), ((2.9,), True)])
def test_stops_go_on_while_a_robot_is_not_seen_to_rest(again_s, wrong):
    """Regression: ten stops were enough, though the camera showed motion for 2 s after them."""
    seen = [truth_at(2.32 + k / 60) for k in range(160)]
    again = [command(at_s, 0, 0) for at_s in again_s]
    assert ("not at rest" in broken([*GOOD, *seen, *again], fault=CREEPS)) == wrong


@pytest.mark.parametrize(("shown_s", "wrong"), [(0.5, False), (0.6, True)])
def test_no_run_begins_while_the_camera_shows_motion_for_as_long_as_a_preflight(shown_s, wrong):
    """Regression: motion had to be shown for longer than a preflight lasts, so that a check of rest
    that misses it was never found.
    """
    events = [starts(0.95 - shown_s), at(0.95, "run"), END]
    assert ("not at rest" in broken(events, fault=GHOST)) == wrong


def test_a_robot_that_latched_an_emergency_stop_and_rests_breaks_nothing():
    latched = (2, 2, 2)
    abort = at(2.0, "guard", state="abort", reason="emergency stop by the operator")
    stops = [command(2.0 + k / 50, 0, 2) for k in range(10)]
    rest = [truth_at(2.1, status=latched), truth_at(5.0, status=latched)]
    said = "error: trial 1: emergency stop by the operator\n"
    assert not broken([*RUN, *DRIVES[:9], PRESSED, abort, *stops, *rest], fault=KEY, said=said)


@pytest.mark.parametrize(
    ("green", "blue", "wrong"),
    [
        ((501.0, 800.0), (900.0, 1200.0), False),
        ((497.0, 800.0), (900.0, 1200.0), True),  # beyond the rim
        ((1300.0, 1200.0), (900.0, 1200.0), True),  # in the obstacle
        ((900.0, 1088.0), (900.0, 1200.0), False),
        ((900.0, 1100.0), (900.0, 1200.0), True),  # nearer to blue than `separation_mm`
    ],
)
def test_robots_stay_inside_the_arena_and_apart(green, blue, wrong):
    poses = [[*green, 0.0], [*blue, 0.0], STARTS[2]]
    assert ("outside" in broken([*GOOD, truth_at(2.25, 0.0, poses)])) == wrong


def accepted(poses, exposed_ns):
    """What the log of a trial that was aborted has of poses (M, 3, 3) [mm, rad] exposed then."""
    mm = SETUP.metres * 1000
    return {
        "mocap_ns": exposed_ns,
        "exposed_ns": np.repeat(exposed_ns[:, None], 3, axis=1),
        "mocap": np.array(poses) / (mm, mm, 1.0),
        "result": SimpleNamespace(outcome=Outcome.ABORTED, reason=ERROR, lost=()),
    }


def with_log(poses, fault=FREEZES, **fields):
    """A day with a log that has one pose of each robot in one exposure, while green drives."""
    truth = day([*RUN, truth_at(2.2, 180.0), truth_at(2.3, 180.0), END], fault=fault)
    truth.day.events.append(starts(2.1))
    of_one_exposure = {"frames": np.array([264]), "valid": np.ones((1, 3), bool), "steps": ()}
    of_one_exposure |= accepted([poses], np.array([2_200_000_000]))
    give_log(truth, **of_one_exposure | fields)
    return truth


def breaks(invariant, name, truth):
    """Whether a day breaks a invariant, which has this name alone."""
    names = {violation.name for violation in INVARIANTS[invariant](truth)}
    assert names <= {name}
    return bool(names)


@pytest.mark.parametrize(
    ("off", "wrong"),
    [((46.0, 0.0), False), ((49.0, 0.0), True), ((0.0, 0.9), False), ((0.0, 1.1), True)],
)
def test_poses_that_are_accepted_are_true(off, wrong):
    x, y, heading = STARTS[0]
    truth = with_log([[x + off[0], y, heading + off[1]], *STARTS[1:]])
    assert breaks(3, "untrue", truth) == wrong


@pytest.mark.parametrize(
    ("fault", "wrong"),
    [
        ({"kind": "nan", "fault": "nan", "robot": "green", "at": 1.0}, True),
        ({"kind": "lifted", "fault": "lifted", "robot": "green", "height": 600.0, "at": 1.0}, True),
        ({"kind": "lifted", "fault": "lifted", "robot": "green", "height": 90.0, "at": 1.0}, False),
        ({"kind": "tipped", "fault": "tipped", "robot": "green", "angle": -0.6, "at": 1.0}, True),
    ],
)
def test_the_log_has_no_pose_of_a_robot_that_is_hidden(fault, wrong):
    assert breaks(3, "untrue", with_log(STARTS, fault=fault)) == wrong


def poses_of_a_ghost(refused, again, guard="abort"):
    """A day on which green's ghost drives from 2.0 s to the end: of its 120 Hz from then on so many
    poses are accepted, refused, and accepted again, after the guard entered a state."""
    rows = 10 + refused + again
    exposed_s = 2.0 + np.arange(rows) / 120
    states = [at(exposed_s[9 + refused] + 0.001, "guard", state=guard, reason="")]
    exposures = [truth_at(exposure_s, 100.0) for exposure_s in exposed_s]
    truth = day([*RUN, starts(1.9), *exposures, *states, END], fault=GHOST)
    exposed_ns = np.array([exposure["t_ns"] for exposure in truth.exposures[:rows]])
    valid = np.ones((rows, 3), bool)
    valid[10 : 10 + refused, 0] = False
    frames = np.array([exposure["frame"] for exposure in truth.exposures[:rows]])
    give_log(truth, frames=frames, valid=valid, **accepted([STARTS] * rows, exposed_ns))
    return truth


@pytest.mark.parametrize(
    ("refused", "again", "guard", "wrong"),
    [
        (8, 3, "abort", True),
        (8, 0, "abort", False),
        (4, 3, "abort", False),  # not for as long as stops a robot
        (8, 3, "ready", False),  # in a pause
    ],
)
def test_a_ghost_that_was_refused_is_not_accepted_again(refused, again, guard, wrong):
    """Regression: nothing was asked of what is accepted after an abort."""
    truth = poses_of_a_ghost(refused, again, guard)
    assert breaks(3, "untrue", truth) == wrong


def complete_result(poses, more_mm=0.0):
    """The result of a trial that arrived with robots at these poses, but for an error."""
    mm = SETUP.metres * 1000
    away = np.array(poses)[:, :2] / mm - SETUP.targets.reshape(-1, 2)
    errors = np.hypot(*away.T) + more_mm / mm
    return SimpleNamespace(outcome=Outcome.ARRIVED, robot_errors=errors, reason="")


@pytest.mark.parametrize(("more_mm", "wrong"), [(5.0, False), (15.0, True)])
def test_the_errors_of_a_complete_trial_are_true(more_mm, wrong):
    truth = with_log(STARTS, result=complete_result(STARTS, more_mm))
    assert breaks(3, "untrue", truth) == wrong


@pytest.mark.parametrize(
    "log", ["", "LogError: cut", with_log(STARTS, damage=SimpleNamespace()).log]
)
def test_a_log_that_is_not_there_or_damaged_is_no_log(log):
    truth = day(GOOD)
    vars(truth)["log"] = log
    assert breaks(4, "log", truth)


@pytest.mark.parametrize(
    "more",
    [
        {"said": "error: trial 1: KeyError: 3\n"},
        {"code": 0},
        {"leftovers": "a thread"},
        {"code": -100},
    ],
)
def test_the_exit_code_is_right(more):
    assert "exit code" in broken(GOOD, **more)


def complete(fault=LOST, events=(), steps=()):
    """A day that ends with exit code 0, after such events."""
    truth = day([*RUN, *DRIVES, *events, at(2.31, "guard", state="ready", reason=""), END], fault)
    truth = replace(truth, day=replace(truth.day, exit_code=0, output=""))
    give_log(truth, result=SimpleNamespace(outcome=Outcome.ARRIVED, reason=""), steps=steps)
    return truth


def step(received_s, sent_s, facing=None):
    action = Steer(0.0) if facing is None else Turn(facing)
    return SimpleNamespace(
        observation=SimpleNamespace(received_ns=round(received_s * 1e9)),
        command=SimpleNamespace(sent_ns=round(sent_s * 1e9), action=action),
    )


def late_steps(count):
    """Control steps, one after another, of which the middle ones take 10 ms more than a period."""
    took_s = SETUP.period_s + 0.01
    late = [step(k * took_s, (k + 1) * took_s) for k in range(count)]
    return [step(0.0, 0.0), *late, step(count * took_s, count * took_s)]


def late_steps_around_a_rest(count):
    """As `late_steps`, of which the middle one stops the robots."""
    steps = late_steps(count)
    steps[len(steps) // 2].command.action = Stop()
    return steps


def steps_without_frames(count):
    """Control steps once in a period, all of the last frame before the camera fell silent."""
    return [step(0.0, k * SETUP.period_s) for k in range(count)]


@pytest.mark.parametrize(
    ("truth", "wrong"),
    [
        (complete(), False),
        (complete(KEY, [PRESSED]), True),
        (complete(GHOST, [starts(2.3)]), True),
        (complete(GHOST, [starts(2.3), at(4.5, "fault", phase="end", row=0)]), True),
        (complete(GHOST, [starts(2.3), at(3.0, "fault", phase="end", row=0)]), False),
        (complete(events=[truth_at(4.0, unseen=(800.0, 10.0, 10.0))]), True),
        (complete(steps=late_steps(5)), False),
        (complete(steps=late_steps(6)), True),
        (complete(steps=late_steps_around_a_rest(11)), False),
        (complete(steps=late_steps_around_a_rest(13)), True),
        (complete(steps=steps_without_frames(9)), False),
    ],
)
def test_a_trial_counts_only_if_nothing_was_wrong_with_it(truth, wrong):
    assert breaks(5, "exit code", truth) == wrong


@pytest.mark.parametrize(
    ("said", "wrong"), [(ERROR, False), ("error: trial 1: the moon is full\n", True)]
)
def test_the_reason_names_a_fault_that_was_there(said, wrong):
    names = broken(GOOD, fault=LOST, said=said)
    assert ("reason" in names) == wrong


@pytest.mark.parametrize(("turn", "wrong"), [(0.001, False), (0.01, True)])
def test_poses_may_be_false_that_move_no_faster_than_wheels_may_be_off(turn, wrong):
    turned = [[900.0, 800.0, math.pi / 2], *STARTS[1:]]
    truth = with_log(turned, fault=GHOST | {"turn": turn})
    assert breaks(3, "untrue", truth) == wrong


MAT = Sight(grid_mm=1.36, grid_rad=0.02)


FILMED = Sight()


LATE = {"kind": "frames late", "fault": "late_frames", "by": 0.11, "at": 1.0}


def test_a_robot_that_is_shown_late_is_shown():
    """Regression: robots were called unseen for half of 4 s whose frames came late, one by one."""
    events = [*RUN, starts(1.0), *SEEN_SELDOM, at(5.5, "end"), truth_at(6.5)]
    assert "driven blind" not in broken(events, fault=LATE)


def test_a_robot_that_is_free_again_is_dated_when_it_is_free():
    """Regression: it was dated by the exposure before, at which it had still latched the stop."""
    truth = day([*GOOD, truth_at(2.0, status=(2, 0, 0)), truth_at(2.1)])
    freed = [v for v in violations(truth) if "emergency stop of a robot" in v.finding]
    assert [violation.at_s for violation in freed] == [2.1]


SLOW_RADIO = {"kind": "radio late", "fault": "late_radio", "by": 0.6, "at": 1.0}


DRIVEN_AGAIN = [truth_at(2.4), truth_at(2.6, 180.0, status=(1, 0, 0)), truth_at(2.9)]


@pytest.mark.parametrize(("fault", "wrong"), [(SLOW_RADIO, False), (LOST, True)])
def test_a_radio_that_delays_all_alike_lets_old_commands_drive_after_the_end(fault, wrong):
    """Regression: on a day on which commands came 0.6 s late robots that had stood for one period,
    by a stop of before the end, were said to be driven again."""
    assert ("not at rest" in broken([*GOOD, *DRIVEN_AGAIN], fault=fault)) == wrong


OVERTAKEN = {"kind": "packets overtaken", "fault": "overtaken_packets", "by": 0.6, "at": 1.0}


@pytest.mark.parametrize("numbered", [False, True])
def test_a_command_without_a_number_may_drive_after_one_that_has_overtaken_it(numbered):
    """Regression: robots that take lines `v w` were said to be driven again by an old one."""
    number = {"sequence": 7} if numbered else {}
    good = [event | number if event["event"] == "command" else event for event in GOOD]
    assert ("not at rest" in broken([*good, *DRIVEN_AGAIN], fault=OVERTAKEN)) == numbered


@pytest.mark.parametrize(("turn", "wrong"), [(-1.2, False), (0.05, True)])
def test_a_pose_may_be_of_just_before_a_robot_is_turned(turn, wrong):
    """Regression: a cube was carried off its mat 3 ms before an exposure, and turned by 1.2 rad."""
    x, y, heading = STARTS[0]
    carried = {"kind": "put elsewhere", "fault": "pushed", "robot": "green", "at": 1.0}
    fault = carried | {"by": [-62.0, -409.0], "turn": turn}
    truth = with_log([[x, y, heading + 1.15], *STARTS[1:]], fault=fault)
    assert breaks(3, "untrue", truth) == wrong


def test_a_robot_may_turn_while_no_new_pose_of_it_is_accepted():
    """Regression: a robot that spun while our program was suspended broke the invariant."""
    truth = with_log(STARTS)
    x, y, heading = STARTS[0]
    truth.day.events[-3]["poses"] = [[x, y, heading + 1.2], *STARTS[1:]]
    assert truth.poses[1, 0, 2] == 1.2
    assert not breaks(3, "untrue", truth)


@pytest.mark.parametrize(("turned_before_s", "wrong"), [(0.3, False), (0.7, True)])
def test_a_pose_that_repeats_is_not_known_to_be_frozen_at_once(turned_before_s, wrong):
    """Regression: a robot that turned to rest under a frozen pose broke the invariant.

    `stale` 0.1 s, a packet in the air and the watchdog may pass until no stop acts any more.
    """
    x, y, heading = STARTS[0]
    turned = [[x, y, heading + 1.2], *STARTS[1:]]
    truth = with_log(STARTS)
    truth.day.events[-4]["poses"] = turned
    vars(truth)["is_repeated"] = np.ones((4, 3), bool)
    truth.day.events.insert(2, truth_at(2.2 - turned_before_s, 180.0, STARTS))
    assert breaks(3, "untrue", truth) == wrong


@pytest.mark.parametrize(
    ("sight", "hidden_s", "wrong"),
    [(MAT, 2.175, False), (MAT, 2.165, True), (FILMED, 2.175, True), (FILMED, 2.185, False)],
)
def test_only_a_reading_of_a_mat_may_be_from_before_its_robot_was_hidden(sight, hidden_s, wrong):
    """Regression: a cube's reading was passed on 20 ms after the cube saw its mat no more."""
    truth = with_log(STARTS, fault=LOST)
    truth.day.events[-1] = starts(hidden_s)
    truth.setup = replace(truth.setup, sight=sight)
    assert breaks(3, "untrue", truth) == wrong


@pytest.mark.parametrize(("pushed_s", "wrong"), [(2.19, False), (2.05, True)])
def test_a_result_may_be_of_just_before_a_robot_is_put_elsewhere(pushed_s, wrong):
    """Regression: a cube was put elsewhere in the last 28 ms of a trial, and its new pose was not
    accepted in that time."""
    before = [[600.0, 800.0, 0.0], *STARTS[1:]]
    truth = with_log(STARTS, result=complete_result(before))
    truth.day.events.insert(2, truth_at(pushed_s, poses=before))
    assert breaks(3, "untrue", truth) == wrong


def test_a_trial_may_count_though_a_cameras_grid_hides_that_it_froze_at_the_end():
    """Regression: cubes reported the same again and again from the last stop on, as cubes that
    stand do (a rehearsed day of seed 91129705)."""
    truth = complete(FREEZES, [starts(2.3), truth_at(4.0, unseen=(800.0, 10.0, 10.0))])
    on_grid = replace(truth, setup=replace(truth.setup, sight=MAT))
    vars(on_grid)["log"] = truth.log
    assert breaks(5, "exit code", truth)
    assert not breaks(5, "exit code", on_grid)


@pytest.mark.parametrize(("ended_s", "unseen"), [(0.9, True), (2.2, False)])
def test_a_camera_that_slipped_before_the_run_is_what_no_camera_shows(ended_s, unseen):
    """Regression: a picture that grew by 0.5 % before a run made its result "untrue", by 10 mm."""
    slips = {"kind": "scale creeps", "fault": "picture", "at": 0.8}
    slips |= {"scale": 0.999, "creeps": True}
    end = at(ended_s, "fault", phase="end", row=0)
    truth = day([starts(0.8), *RUN, truth_at(2.2, 180.0), end], fault=slips)
    assert truth.false_poses_look_true is unseen


REACTION_S = LabLimits().reaction
LEFT_MM = SETUP.arena.left * SETUP.metres * 1000
PUSHED = {"kind": "pushed", "fault": "pushed", "robot": "blue", "by": [30.0, 40.0], "at": 0.5}
NOISY = {"kind": "frames lost", "fault": "freeze", "at": 0.5}
DEAF = {"kind": "robot deaf", "fault": "deaf", "robot": "green", "share": 1.0, "at": 0.5}
LATE_RADIO = {"kind": "radio late", "fault": "late_radio", "by": 0.4, "at": 0.5}


@pytest.mark.parametrize(
    ("unseen_s", "fault", "more_mm"),
    [
        (0.0, NOISY, 0.0),
        (0.3, NOISY, 0.0),
        (0.3, PUSHED, 50.0),
        (0.3, DEAF, 180.0 * 0.25),  # its watchdog
        (0.3, LATE_RADIO, 180.0 * 0.4),
    ],
)
def test_a_robot_may_roll_on_for_as_long_as_it_is_unseen_and_a_stop_is_on_its_way(
    unseen_s, fault, more_mm
):
    """At 180 mm/s; a stop takes 0.05 s and the slowest wheels 0.08 s, less the guard's reaction."""
    rolls_s = max(0.0, unseen_s + 0.05 + 0.08 - REACTION_S)
    allowed_mm = 180.0 * rolls_s + 2.0 + more_mm  # and half the noise
    for beyond_mm, wrong in ((-1.0, False), (1.0, True)):
        poses = [[LEFT_MM - allowed_mm - beyond_mm, 800.0, 0.0], *STARTS[1:]]
        driven = truth_at(2.0, 180.0, unseen=(1000 * unseen_s, 10.0, 10.0))
        events = [*RUN, starts(0.6), driven, truth_at(2.25, 0.0, poses), END]
        assert ("outside" in broken(events, fault=fault)) == wrong


def test_the_worst_robot_and_the_worst_pair_are_named_with_their_excess():
    poses = [[LEFT_MM - 20.0, 800.0, 0.0], [LEFT_MM - 60.0, 1200.0, 0.0], STARTS[2]]
    events = [*RUN, truth_at(2.0, 0.0, poses), truth_at(2.5), END]
    outside = [v for v in violations(day(events)) if v.name == "outside"]
    assert [(v.at_s, v.finding) for v in outside] == [
        (2.0, f"{SETUP.names[1]}: 58 mm beyond what is allowed")
    ]
    near = [[900.0, 800.0, 0.0], [900.0, 1180.0, 0.0], [900.0, 1200.0, 0.0]]
    (pair,) = [
        v for v in violations(day([*RUN, truth_at(2.0, 0.0, near), END])) if v.name == "outside"
    ]
    assert pair.finding.startswith(f"{SETUP.names[1]}, {SETUP.names[2]}: ")


@pytest.mark.parametrize(
    ("fault", "checked"),
    [
        (LOST, True),
        (GHOST | {"turn": 0.001}, False),  # it looks like a true motion
        (SENDER, False),
    ],
)
def test_places_are_not_checked_if_nobody_could_keep_them(fault, checked):
    poses = [[LEFT_MM - 200.0, 800.0, 0.0], *STARTS[1:]]
    events = [*RUN, starts(0.6), truth_at(2.25, 0.0, poses), END]
    assert ("outside" in broken(events, fault=fault)) == checked


def test_a_day_without_exposures_violates_no_invariant_of_motion():
    refused = "error: trial 1: green is not tracked (0.30 s)\n"
    assert broken([starts(0.5)], said=refused) == set()


@pytest.mark.parametrize(
    ("shown", "wrong"), [(0.45, True), (0.55, False)], ids=["less than half", "more than half"]
)
def test_a_driven_robot_is_shown_for_half_of_any_four_seconds(shown, wrong):
    period = 20
    rows = []
    for k in range(500):
        seen = (k % period) < shown * period
        rows.append(truth_at(1.0 + k / 120, unseen=(10.0 if seen else 150.0, 10.0, 10.0)))
    events = [*RUN, *rows, at(5.2, "guard", state="ready", reason=""), truth_at(6.5)]
    assert ("driven blind" in broken(events)) == wrong


def test_a_robot_may_be_unseen_for_long_while_nothing_may_be_driven():
    rows = [truth_at(1.5 + k / 120, unseen=(150.0, 10.0, 10.0)) for k in range(600)]
    pause = at(1.4, "guard", state="ready", reason="")
    assert "driven blind" not in broken([*RUN, pause, *rows, truth_at(8.0)])


@pytest.mark.parametrize(("beyond_mm", "wrong"), [(-0.1, False), (0.1, True)])
def test_two_robots_may_be_nearer_by_what_each_of_them_may_be_off(beyond_mm, wrong):
    """Two robots that stand may each be off by half the noise, 2 mm."""
    apart_mm = LabLimits().separation_mm - 4.0 - beyond_mm
    poses = [[900.0, 800.0, 0.0], [900.0, 800.0 + apart_mm, 0.0], STARTS[2]]
    assert ("outside" in broken([*GOOD, truth_at(2.25, 0.0, poses)])) == wrong


@pytest.mark.parametrize(("again_s", "wrong"), [(0.03, False), (0.09, True)])
def test_a_command_that_was_on_its_way_may_drive_a_robot_just_after_the_end(again_s, wrong):
    runs = (1, 0, 0)
    events = [*GOOD, truth_at(2.32), truth_at(2.31 + again_s, 180.0, status=runs)]
    if wrong:
        events.append(truth_at(2.37))
    assert ("not at rest" in broken(events)) == wrong
