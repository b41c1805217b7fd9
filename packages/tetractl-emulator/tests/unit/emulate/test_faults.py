"""Tests of how each fault changes its device, and undoes the change afterwards."""

import gc
import json
import math
import weakref
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, get_args

import pytest
from testkit.emulator.acting import act
from testkit.emulator.device_specs import APRILTAG_SPEC, FIELD_SPEC
from testkit.emulator.lab_processes import emulated, turn_until
from testkit.emulator.virtual_lab import virtual_lab
from testkit.lab_specs import SPEC
from testkit.paths import EXAMPLES, SCRIPTS
from tetractl_emulator.optitrack.scripted import FAULTS
from tetractl_emulator.optitrack.tracked_body import Asset, PoseNoise, TrackedBody, View
from tetractl_emulator.process import PROCESS_FAULTS

from tetractl.core.clock import SECOND
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.cobs import Flag
from tetractl.spec.lab_section import entry
from tetractl.spec.yaml.document import parse_document

RUN = ((60, 60), (60, 60))
FIELD = (
    "off",
    "low_supply, millivolts: 9000",
    "hot, celsius: 85",
    "mute",
    "late_driver, by: 0.2",
    "doubled_commands",
    "bad_bytes, share: 0.1",
    "weak_coils, axis: y, share: -0.5",
    "turned_coils, by: 0.4",
)
STREAM = (
    "no_frames",
    "repeat",
    "half_rate",
    "half_rate, every: 7",
    "late_pictures, by: 0.3",
    *(f"bad_pictures, share: 1, how: {how}" for how in ("cut", "lost", "doubled")),
)
MICROSCOPE = (
    *STREAM,
    "light, share: 0.5",
    "focus, by_um: 30",
    "knocked, by_um: [40, 0]",
    "bubble",
    "untracked, cell: cell 1",
)
PROCESS = {get_args(kind.model_fields["fault"].annotation)[0] for kind in PROCESS_FAULTS}
ELSEWHERE = {"unplug", "stuck_port", "pushed", "stopped_elsewhere", "driven_elsewhere", *PROCESS}
"""Faults that no device holds: there is nothing to undo."""


def shipped_faults():
    """The faults of all shipped scripts that are undone, the last of each kind, by its name."""
    faults = {}
    for path in sorted(SCRIPTS.glob("*.yaml")):
        script = parse_document(path.read_text(), "script").data
        for fault in script.get("faults", ()):
            faults[fault["fault"]] = json.dumps(fault).replace('"red"', '"blue"')
    return {name: fault for name, fault in faults.items() if name not in ELSEWHERE}


def undone_faults():
    """Specs of labs, and a fault of each: those of shipped scripts, and of a field's driver."""
    cases = [pytest.param(SPEC, fault, id=name) for name, fault in shipped_faults().items()]
    cases.append(pytest.param(APRILTAG_SPEC, "{fault: untracked, robot: green}", id="hidden tag"))
    of_field = [pytest.param(FIELD_SPEC, f"{{fault: {text}}}", id=text) for text in FIELD]
    return [*cases, *of_field]


def robot_state(robot):
    return {**vars(robot), "core": 0, "robots": 0, "acting": 0, "_switched_on_ms": 0}


def state(lab, name):
    """All that a fault of this name may change: what acts; of the camera's side, of the driver, of
    robots."""
    camera = lab.camera
    actuator = lab.actuator
    parts = [*lab.injector.acting.of_kind(name)]
    if hasattr(camera, "view"):
        parts += [[*camera.clock_errors]]
    if hasattr(actuator, "radio"):
        parts += map(robot_state, actuator.robots)
    else:
        parts += [actuator.driver.powered, actuator.dish.field.coils]
    return repr(parts)


@dataclass(frozen=True)
class FaultyLab:
    """A lab that is not open, its script's one fault, and the device that has it."""

    lab: Any
    fault: Any
    device: Any

    def begin(self):
        """Begin the fault; return what ends it."""
        return self.lab.injector.act(self.fault)


def faulty_lab(folder, fault, spec=SPEC):
    lab = emulated(folder, script=f"faults: [{fault}]", spec=spec)
    (only_fault,) = lab.injector.faults
    return FaultyLab(lab, only_fault, lab.injector.device_of(only_fault))


@pytest.mark.parametrize(("spec", "fault"), undone_faults())
def test_a_fault_changes_its_device_and_takes_it_back(tmp_path, spec, fault):
    if spec == APRILTAG_SPEC:
        pytest.importorskip("cv2")
    faulty = faulty_lab(tmp_path, fault, spec)
    name = faulty.fault.fault
    before = state(faulty.lab, name)
    end = faulty.begin()
    assert state(faulty.lab, name) != before
    end()
    assert state(faulty.lab, name) == before


@pytest.mark.parametrize("text", MICROSCOPE)
def test_a_fault_of_pictures_is_taken_back(tmp_path, text):
    pytest.importorskip("cv2")
    dish = EXAMPLES / "tetrahymena_dish.yaml"
    script = f"faults: [{{fault: {text}}}]"
    with virtual_lab(tmp_path, spec=dish, script=script) as lab:
        camera = lab.emulation.camera
        (fault,) = lab.emulation.injector.faults

        def picture_state():
            acting = [*lab.emulation.injector.acting.of_kind(fault.fault)]
            return repr([acting, camera._look()])

        before = picture_state()
        end = lab.emulation.injector.act(fault)
        assert picture_state() != before
        end()
        assert picture_state() == before


@pytest.mark.long
def test_pictures_are_late_lost_or_doubled_and_what_is_shown_is_known(tmp_path):
    """From 1 s on pictures come 0.2 s later, from 2 s on all are lost, those under way too."""
    pytest.importorskip("cv2")
    late = "{fault: late_pictures, since: start, at: 1, by: 0.2}"
    lost = "{fault: bad_pictures, since: start, at: 2, share: 1, how: lost}"
    received_s = []
    with virtual_lab(tmp_path, spec=APRILTAG_SPEC, script=f"faults: [{late}, {lost}]") as lab:
        camera = lab.emulation.camera
        latency_s = camera.pictures.latency_ns / SECOND
        camera.join(lambda jpeg: received_s.append(lab.clock.now() / SECOND))

        def age_shown_at(time_s):
            lab.clock.sleep_until(round(time_s * SECOND))
            return time_s - max(camera.shown_ns) / SECOND

        assert age_shown_at(0.9) == pytest.approx(latency_s, abs=0.04)
        assert age_shown_at(1.9) == pytest.approx(latency_s + 0.2, abs=0.04)
        assert age_shown_at(2.9) == pytest.approx(0.9 + latency_s + 0.2, abs=0.04)
    assert max(received_s) < 2.01


class Kept(list):
    """Which bodies a picture shows; can be referred to weakly."""


def test_what_pictures_over_http_show_is_not_kept(tmp_path):
    """What has come is not known there, and what each picture showed was kept without end."""
    pytest.importorskip("cv2")
    from tetractl_emulator.pictures.apriltag.side import AprilTagSettings, EmulatedAprilTag

    kept = []

    class Watched(EmulatedAprilTag):
        def _visible_now(self):
            visible = Kept(super()._visible_now())
            kept.append(weakref.ref(visible))
            return visible

        def _draw(self, exposed_ns):
            return exposed_ns

    with virtual_lab(tmp_path, spec=APRILTAG_SPEC) as lab:
        stage = lab.emulation.camera._stage
        over_http = replace(stage, wires=replace(stage.wires, http=True))
        camera = Watched(over_http, AprilTagSettings(), [])
        for picture in range(3):
            assert camera._draw_exposure(picture) == picture
        gc.collect()
    assert list(camera.shown_ns) == []
    assert [reference() for reference in kept if reference() is not None] == []


TICKS_PER_S = 1e7


@pytest.mark.parametrize(
    ("fault", "gained_s"),
    [("{fault: clock_jump, by: -0.5}", -0.5), ("{fault: clock_rate, rate: 3}", 2.0)],
)
def test_the_servers_clock_is_set_or_runs_wrongly(tmp_path, fault, gained_s):
    """What it has gained a second later."""
    faulty = faulty_lab(tmp_path, fault)
    clock = faulty.lab.camera
    then_ns = faulty.lab.timeline.now_ns + SECOND
    before = clock.ticks(then_ns)
    faulty.begin()
    assert (clock.ticks(then_ns) - before) / TICKS_PER_S == pytest.approx(gained_s)


def test_a_change_of_the_picture_takes_only_itself_back(tmp_path):
    """Regression: of two that overlapped, the first one's end changed nothing, and the end of a
    change took back how the picture had crept during it."""
    knock = faulty_lab(tmp_path, "{fault: picture, by: [40, 0], scale: 2, turn: 0.5}")
    kind = type(knock.fault)
    shift = kind(fault="picture", by=(0, 10))
    creeping = kind(fault="picture", by=(1, 0), turn=0.25, creeps=True)
    acting = knock.lab.injector.acting

    def exposed():
        view = knock.lab.camera.view.at_exposure(acting.of_kind("picture"))
        return view.shift_mm, view.scale, view.turned_rad

    end_knock = knock.begin()
    end_shift = knock.lab.injector.act(shift)
    end_creeping = knock.lab.injector.act(creeping)
    assert exposed() == (40 + 10j + 1, 2.0, 0.5 + 0.25)
    end_knock()
    assert exposed() == (10j + 2, 1.0, 0.5)
    end_shift()
    end_creeping()
    assert exposed() == (2, 1.0, 0.5)  # where it has crept


@pytest.mark.slow
def test_robots_are_put_back_and_restarted(tmp_path):
    reports = []
    lab = emulated(tmp_path, replace_after=0.1, tell=lambda event, facts: reports.append(event))
    with lab:
        robot = entry(lab.actuator.robots, "green")
        robot.receive(encode_command(BroadcastCommand(1, Flag.RUN, RUN)))
        turn_until(lab, lambda: robot.x > 510)
        robot.receive(encode_command(BroadcastCommand(2, Flag.EMERGENCY_STOP)))
        turn_until(lab, lambda: lab.injector.acting.robots_are_carried)
        assert not robot.powered
        turn_until(lab, lambda: "placed" in reports)
        assert robot.x == 500
        assert robot.y == 500
        assert robot.heading == 0.5
        robot.receive(encode_command(BroadcastCommand(3, Flag.RUN, RUN)))
        assert robot.counts() == (0, 0)  # it may be a command from before
        placed_ns = lab.timeline.now_ns
        turn_until(lab, lambda: lab.timeline.now_ns > placed_ns + SECOND)
        robot.receive(encode_command(BroadcastCommand(3, Flag.RUN, RUN)))
        assert robot.counts() == (60, 60)


def open_files():
    return {path.name for path in Path("/proc/self/fd").iterdir()}


def test_a_fault_is_over_after_its_time(tmp_path):
    script = "faults: [{fault: untracked, robot: green, since: start, at: 0.1, for: 0.2}]"
    with virtual_lab(tmp_path, script=script) as lab:
        acting = lab.emulation.injector.acting
        untracked = []
        for tenth in range(5):
            lab.clock.sleep_until((tenth * 10 + 5) * SECOND // 100)
            untracked.append(len(acting.of_kind("untracked", "green")))
    assert untracked == [0, 1, 1, 0, 0]


def test_nothing_is_left_open(tmp_path):
    before = open_files()
    for _ in range(3):
        with emulated(tmp_path) as lab:
            lab.actuator.set_plugged(False)
            lab.actuator.set_plugged(True)
    assert open_files() == before
    assert [path.name for path in tmp_path.iterdir()] == ["record.jsonl"]


def test_faults_of_the_servers_clock_add_up_and_each_takes_its_own_back(tmp_path):
    """Regression: of two that overlapped, the first one's end changed nothing, and a change of rate
    took back what the one before had gained."""
    jump = faulty_lab(tmp_path, "{fault: clock_jump, by: 1}")
    fast = faulty_lab(tmp_path, "{fault: clock_rate, rate: 3}").fault
    clock = jump.lab.camera
    then_ns = jump.lab.timeline.now_ns + SECOND
    right = clock.ticks(then_ns)

    def gained_s():
        return (clock.ticks(then_ns) - right) / TICKS_PER_S

    end_first_jump = jump.begin()
    end_first_rate = jump.lab.injector.act(fast)
    end_second_jump = jump.begin()
    end_second_rate = jump.lab.injector.act(fast)
    assert gained_s() == pytest.approx(2 * 1 + 2 * (3 - 1))
    end_first_jump()
    assert gained_s() == pytest.approx(1 + 2 * (3 - 1))
    end_first_rate()
    assert gained_s() == pytest.approx(1 + (3 - 1))
    end_second_rate()
    end_second_jump()
    assert clock.ticks(then_ns) == right


def test_a_picture_creeps_by_all_changes_and_stays_where_they_brought_it(tmp_path):
    """Regression: a change that crept took the place of the one that crept before, though the table
    says that changes of the picture add up."""
    sliding = faulty_lab(tmp_path, "{fault: picture, by: [3, 0], creeps: true}")
    turning = type(sliding.fault)(fault="picture", turn=0.25, creeps=True)
    view = sliding.lab.camera.view
    end_sliding = sliding.begin()
    end_turning = sliding.lab.injector.act(turning)
    acting = sliding.lab.injector.acting
    view.at_exposure(acting.of_kind("picture"))
    end_sliding()
    view.at_exposure(acting.of_kind("picture"))
    end_turning()
    view.at_exposure(acting.of_kind("picture"))
    assert view.shift_mm == 3
    assert view.turned_rad == 2 * 0.25


def body_at_origin():
    """What the cameras track of a robot at the origin that looks along x."""
    robot = SimpleNamespace(name="green", x=0.0, y=0.0, heading=0.0)
    return TrackedBody(robot, Asset(1, "green"), PoseNoise(0.0, 0.0, Random(0)))


def begin_on(body, name, **fields):
    """Begin a fault of this name on a body; return what ends it."""
    kind = next(kind for kind in FAULTS if kind.__name__ == name)
    fault = kind(fault=name, robot="green", **fields)
    body.acting.add(fault)
    return partial(body.acting.remove, fault)


def test_a_jump_of_a_body_that_moves_away_does_not_hold_it_up():
    """Regression: after a jump, the body was where it had been when it jumped.

    A ghost moves on by 1 mm each frame.
    """
    body = body_at_origin()
    begin_on(body, "ghost", by=(1, 0))
    end_jump = begin_on(body, "jump", by=(100, 0))
    assert body.expose(View()).position[0] == pytest.approx(0.101)
    end_jump()
    assert body.expose(View()).position[0] == pytest.approx(0.002)


def test_a_body_that_repeats_its_pose_has_the_number_of_its_twin_at_once(tmp_path):
    """Regression: it was reported with the number that it had had in its last new pose."""
    faulty = faulty_lab(tmp_path, "{fault: twin_id, robot: green, other: blue}")
    camera = faulty.lab.camera
    green, blue = (body.id for body in camera._expose_bodies())
    act(camera.acting, "repeat", robot="green")
    end = faulty.begin()
    assert [body.id for body in camera._expose_bodies()] == [blue, blue]
    end()
    assert [body.id for body in camera._expose_bodies()] == [green, blue]


@pytest.mark.parametrize("carried_first", [False, True])
def test_a_body_that_a_fault_hides_remains_hidden_when_robots_are_put_down(tmp_path, carried_first):
    """Regression: putting robots down ended such a fault; and if it began and ended while they were
    carried, the body was not tracked any more."""
    faulty = faulty_lab(tmp_path, "{fault: untracked, robot: green}")
    camera = faulty.lab.camera
    bodies = {body.robot.name: body for body in camera.tracked}
    green = bodies["green"]
    faulty.lab.injector.acting.robots_are_carried = carried_first
    end_fault = faulty.begin()
    faulty.lab.injector.acting.robots_are_carried = True
    assert not green.expose(View()).tracking_valid
    faulty.lab.injector.acting.robots_are_carried = False
    assert not green.expose(View()).tracking_valid
    end_fault()
    assert green.expose(View()).tracking_valid
    assert bodies["blue"].expose(View()).tracking_valid


def test_faults_of_one_body_act_together():
    """Regression: a body without a position had one again once it was tipped."""
    body = body_at_origin()
    end_nan = begin_on(body, "nan")
    end_tipped = begin_on(body, "tipped", angle=1.0)
    assert math.isnan(body.expose(View()).position[0])
    end_nan()
    tipped = body.expose(View())
    assert tipped.position[0] == 0.0
    assert tipped.quaternion[0] == pytest.approx(math.sin(1.0 / 2))
    end_tipped()
    assert body.expose(View()).quaternion == (0.0, 0.0, 0.0, 1.0)
