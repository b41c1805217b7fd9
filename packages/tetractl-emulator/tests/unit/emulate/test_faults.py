"""What each fault does to its device and takes back; what a run makes of it is in `tests/plays`."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import pytest
from support.device_specs import APRILTAG_SPEC, FIELD_SPEC
from support.lab_processes import emulated, turn_until
from support.lab_specs import SPEC
from support.paths import EXAMPLES, SCRIPTS
from support.virtual_lab import virtual_lab
from tetractl_emulator.faults import Injector, Visible, fault_kind, setting
from tetractl_emulator.loop import Timeline
from tetractl_emulator.optitrack.scripted import FAULTS
from tetractl_emulator.optitrack.tracked_body import TrackedBody, View
from tetractl_emulator.process import PROCESS_FAULTS

from tetractl.core.clock import SECOND
from tetractl.experiment.yaml.document import parse_document
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.cobs import Flag

RADIO = ("loss", "late_ns", "jitter_ns", "doubled", "_down", "speed", "noise")
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
ELSEWHERE = {"unplug", "stuck_port", "pushed", "stopped_elsewhere", *PROCESS}  # nothing to undo


def shipped():
    """The faults of all shipped scripts, one of each kind, and those of a field's driver."""
    found = {}
    for path in sorted(SCRIPTS.glob("*.yaml")):
        for fault in parse_document(path.read_text(), "script").data.get("faults", ()):
            if fault["fault"] not in ELSEWHERE:
                found[fault["fault"]] = json.dumps(fault).replace('"red"', '"blue"')
    rows = [pytest.param(SPEC, text, id=kind) for kind, text in found.items()]
    rows.append(pytest.param(APRILTAG_SPEC, "{fault: untracked, robot: green}", id="hidden tag"))
    return [*rows, *(pytest.param(FIELD_SPEC, f"{{fault: {text}}}", id=text) for text in FIELD)]


def state(lab):
    """All that a fault may change: of the camera's side, of the radio or the driver, of robots."""
    camera = lab.camera
    actuator = lab.actuator
    parts = [camera.renderer.hidden] if hasattr(camera, "renderer") else [camera.swapped]
    if hasattr(camera, "trouble"):
        parts += [camera.trouble, camera.clock, camera.view]
        parts += [
            {k: v for k, v in fields(body).items() if k != "robot"} for body in camera.tracked
        ]
    if hasattr(actuator, "radio"):
        parts += [
            *(getattr(actuator.radio, name) for name in RADIO),
            *({**vars(r), "core": 0, "robots": 0} for r in actuator.robots),
        ]
    else:
        driver = actuator.driver
        parts += [driver.powered, driver.mute, driver.supply_mv, driver.temperature_dc]
        parts += [driver.late_ns, driver.doubled, driver.noise, actuator.dish.coils]
    return repr(parts)


def fields(thing):
    return {name: getattr(thing, name) for name in type(thing).__dataclass_fields__}


def begun(folder, fault, spec=SPEC):
    """A lab that is not open, its script's one fault, and the device that has it."""
    lab = emulated(folder, script=f"faults: [{fault}]", spec=spec)
    (found,) = lab.injector.faults
    return lab, found, lab._device_of(found)


@pytest.mark.parametrize(("spec", "fault"), shipped())
def test_a_fault_changes_its_device_and_takes_it_back(tmp_path, spec, fault):
    if spec == APRILTAG_SPEC:
        pytest.importorskip("cv2")
    lab, found, device = begun(tmp_path, fault, spec)
    before = state(lab)
    undo = found.begin(device)
    assert state(lab) != before
    undo()
    assert state(lab) == before


@pytest.mark.parametrize("text", MICROSCOPE)
def test_a_fault_of_pictures_is_taken_back(tmp_path, text):
    pytest.importorskip("cv2")
    side = EXAMPLES / "tetrahymena_dish.yaml"
    many = f"faults: [{{fault: {text}}}]"
    with virtual_lab(tmp_path, spec=side, script=many) as lab:
        camera, (fault,) = lab.emulation.camera, lab.emulation.injector.faults
        stream = camera.camera

        def now():
            sent = len(stream.changes), stream.latency_ns, stream.every, stream.frozen.is_set()
            return repr((sent, camera.painter.look, camera.hidden))

        before = now()
        undo = fault.begin(camera)
        assert now() != before
        undo()
        assert now() == before


def test_pictures_are_late_lost_or_doubled_and_what_is_shown_is_known(tmp_path):
    pytest.importorskip("cv2")
    came = []
    faults = "{fault: late_pictures, since: start, at: 1, by: 0.2}"
    lost = "{fault: bad_pictures, since: start, at: 2, share: 1, how: lost}"
    with virtual_lab(tmp_path, spec=APRILTAG_SPEC, script=f"faults: [{faults}, {lost}]") as lab:
        camera = lab.emulation.camera
        clock = lab.clock
        latency_s = camera.camera.latency_ns / SECOND
        camera.join(lambda jpeg: came.append(clock.now() / SECOND))
        ages = []
        for seconds in (0.9, 1.9, 2.9):
            clock.sleep_until(round(seconds * SECOND))
            ages.append(seconds - max(camera.shown_ns) / SECOND)
    assert ages[0] == pytest.approx(latency_s, abs=0.04)
    assert ages[1] == pytest.approx(latency_s + 0.2, abs=0.04)
    assert ages[2] == pytest.approx(0.9 + latency_s + 0.2, abs=0.04)  # those under way are lost
    assert max(came) < 2.01


@pytest.mark.parametrize(
    ("fault", "gained"),
    [("{fault: clock_jump, by: -0.5}", -0.5), ("{fault: clock_rate, rate: 3}", 2.0)],
)
def test_the_servers_clock_is_set_or_runs_wrongly(tmp_path, fault, gained):
    lab, found, device = begun(tmp_path, fault)
    then = lab.timeline.now_ns + SECOND
    before = lab.camera.clock.ticks(then)
    found.begin(device)
    assert (lab.camera.clock.ticks(then) - before) / 1e7 == pytest.approx(gained)


def test_faults_of_the_servers_clock_add_up_and_each_takes_its_own_back(tmp_path):
    """Regression: of two that overlapped, the first one's end changed nothing, and a change of rate
    took back what the one before had gained."""
    lab, jump, device = begun(tmp_path, "{fault: clock_jump, by: 1}")
    fast = type(begun(tmp_path, "{fault: clock_rate, rate: 3}")[1])(fault="clock_rate", rate=3)
    clock = lab.camera.clock
    then = lab.timeline.now_ns + SECOND
    right = clock.ticks(then)

    def gained_s():
        return (clock.ticks(then) - right) / 1e7

    ends = [jump.begin(device), fast.begin(device), jump.begin(device), fast.begin(device)]
    assert gained_s() == pytest.approx(6.0)
    ends[0]()
    assert gained_s() == pytest.approx(5.0)
    ends[1]()
    assert gained_s() == pytest.approx(3.0)
    ends[3]()
    ends[2]()
    assert clock.ticks(then) == right


def test_a_change_of_the_picture_takes_only_itself_back(tmp_path):
    """Regression: of two that overlapped, the first one's end changed nothing, and the end of a
    change took back how the picture had crept during it."""
    lab, change, device = begun(tmp_path, "{fault: picture, by: [40, 0], scale: 2, turn: 0.5}")
    other = type(change)(fault="picture", by=(0, 10))
    creeping = type(change)(fault="picture", by=(1, 0), turn=0.25, creeps=True)
    view = lab.camera.view
    end = change.begin(device)
    end_other = other.begin(device)
    end_creeping = creeping.begin(device)
    view.creep()
    assert (view.shift, view.grown, view.turned) == (41 + 10j, 2.0, 0.75)
    end()
    assert (view.shift, view.grown, view.turned) == (1 + 10j, 1.0, 0.25)
    end_other()
    end_creeping()
    assert (view.shift, view.grown, view.turned) == (1 + 0j, 1.0, 0.25)


def test_a_jump_of_a_body_that_moves_away_does_not_hold_it_up():
    """Regression: after a jump, the body was where it had been when it jumped."""
    body = TrackedBody(SimpleNamespace(name="green", x=0.0, y=0.0, heading=0.0), 1, "green")
    device = SimpleNamespace(tracked_body=lambda name: body)
    kinds = {get_args(kind.model_fields["fault"].annotation)[0]: kind for kind in FAULTS}
    kinds["ghost"](fault="ghost", robot="green", by=(1, 0)).begin(device)
    end_jump = kinds["jump"](fault="jump", robot="green", by=(100, 0)).begin(device)
    assert body.expose(View()).position[0] == pytest.approx(0.101)
    end_jump()
    assert body.expose(View()).position[0] == pytest.approx(0.002)


def test_a_robot_with_another_number_obeys_that_one(tmp_path):
    lab, fault, device = begun(tmp_path, "{fault: wrong_id, robot: green, id: 1}")
    fault.begin(device)
    robot = lab.actuator.robot("green")
    robot.hear(encode_command(BroadcastCommand(1, Flag.RUN, ((10, 10), (20, 20)))))
    assert robot.counts() == (20, 20)


@pytest.mark.slow
def test_robots_are_put_back_and_restarted(tmp_path):
    reports = []
    lab = emulated(tmp_path, replace_after=0.1, tell=lambda event, facts: reports.append(event))
    with lab:
        robot = lab.actuator.robot("green")
        robot.hear(encode_command(BroadcastCommand(1, Flag.RUN, RUN)))
        turn_until(lab, lambda: robot.x > 510)
        robot.hear(encode_command(BroadcastCommand(2, Flag.EMERGENCY_STOP)))
        turn_until(lab, lambda: not lab.camera.tracked[0].tracked)
        assert not robot.powered
        turn_until(lab, lambda: "placed" in reports)
        assert (robot.x, robot.y, robot.heading) == (500, 500, 0.5)
        robot.hear(encode_command(BroadcastCommand(3, Flag.RUN, RUN)))
        assert robot.counts() == (60, 60)


def open_files():
    return {path.name for path in Path("/proc/self/fd").iterdir()}


def test_a_fault_is_over_after_its_time(tmp_path):
    script = "faults: [{fault: untracked, robot: green, since: start, at: 0.1, for: 0.2}]"
    with virtual_lab(tmp_path, script=script) as lab:
        body = lab.emulation.camera.tracked_body("green")
        tracked = []
        for tenth in range(5):
            lab.clock.sleep_until((tenth * 10 + 5) * SECOND // 100)
            tracked.append(body.tracked)
    assert tracked == [True, False, False, True, True]


def test_a_fault_is_told_with_the_first_frame_that_was_exposed_during_it():
    reports = []
    timeline = Timeline(lambda until_ns: None)
    hidden = fault_kind("hidden", "A fault.", lambda *_: lambda: None, Visible.EXPOSED)
    faults = (hidden(fault="hidden", since="start"),)
    injector = Injector(timeline, faults, lambda _: None, lambda phase, _: reports.append(phase))
    injector.happened("start")
    timeline.run_to(0)
    injector.exposed(7)
    injector.sent(6)  # was under way when the fault began
    assert reports == []
    injector.sent(7)
    assert reports == ["start"]


def test_nothing_is_left_open(tmp_path):
    before = open_files()
    for _ in range(3):
        with emulated(tmp_path) as lab:
            lab.actuator.plugged(False)
            lab.actuator.plugged(True)
    assert open_files() == before
    assert [path.name for path in tmp_path.iterdir()] == ["record.jsonl"]


class Thing:
    value = 0
    other = 0


@pytest.mark.parametrize(
    "order", [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]
)
def test_what_faults_set_remains_until_each_has_ended(order):
    """Regression: a body that was tipped for a second hid for that second that it was untracked."""
    thing = Thing()
    running = {n: n + 1 for n in range(3)}
    ends = [setting(thing, value=n + 1) for n in range(3)]
    for n in order:
        ends[n]()
        del running[n]
        assert thing.value == max(running.values(), default=0)


def test_faults_that_set_other_values_do_not_meet():
    thing = Thing()
    first = setting(thing, value=1)
    second = setting(thing, other=2)
    first()
    assert (thing.value, thing.other) == (0, 2)
    second()
    assert (thing.value, thing.other) == (0, 0)


def test_faults_of_one_body_act_together():
    """Regression: a body without a position had one again once it was tipped."""
    body = TrackedBody(SimpleNamespace(name="green", x=0.0, y=0.0, heading=0.0), 1, "green")
    device = SimpleNamespace(tracked_body=lambda name: body)
    kinds = {get_args(kind.model_fields["fault"].annotation)[0]: kind for kind in FAULTS}
    first = kinds["nan"](fault="nan", robot="green")
    second = kinds["tipped"](fault="tipped", robot="green", angle=1.0)
    end_first, end_second = (type(each).begin(each, device) for each in (first, second))
    assert math.isnan(body.expose(View()).position[0])
    end_first()
    assert body.expose(View()).position[0] == 0.0
    assert body.expose(View()).quaternion[0] == pytest.approx(math.sin(0.5))
    end_second()
    assert body.expose(View()).quaternion == (0.0, 0.0, 0.0, 1.0)
