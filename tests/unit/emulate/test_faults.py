"""What each fault does to its device and takes back; what a run makes of it is in `tests/plays`."""

import math
from pathlib import Path

import pytest
from support.emulated_lab import APRILTAG_SPEC, FIELD_SPEC, SPEC, emulated, turn_until

from tetractl.core.clock import SECOND
from tetractl.emulate.faults import Visible
from tetractl.emulate.optitrack.tracked_body import expose
from tetractl.emulate.script import Sides
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, Flag, encode_command
from tetractl.lab.cameras.optitrack.natnet_messages import Version

RUN = ((60, 60), (60, 60))


def bodies(lab):
    """What the cameras give of the bodies now, to 6 digits."""
    camera = lab.camera
    found = expose(camera.tracked, camera.view, camera.swapped, camera.hidden)
    parts = [(body.id, body.tracking_valid, *body.position, *body.quaternion) for body in found]
    return [tuple(round(part, 6) + 0.0 for part in body) for body in parts]


def trouble(name):
    return lambda lab: getattr(lab.camera.motive.trouble, name)


def green(name):
    return lambda lab: getattr(lab.actuator.robot("green"), name)


def ticks(ns):
    return lambda lab: lab.camera.motive.server.clock.ticks(ns)


UPRIGHT = (0.0, 0.247404, 0.0, 0.968912)  # 0.5 rad about the vertical
BLUE = (7, True, 0.5, 0.06, -1.5, 0.0, -0.841471, 0.0, 0.540302)


def shown(x=0.5, height=0.06, z=-0.5, quaternion=UPRIGHT, number=1, valid=True):
    return [(number, valid, x, height, z, *quaternion), BLUE]


OPTITRACK = [
    ("no_server", trouble("silent"), True),
    ("no_frames", trouble("no_frames"), True),
    ("freeze", trouble("frozen"), True),
    ("edit_mode", trouble("edit_mode"), True),
    ("counter_back, frames: 500", trouble("counter"), 500),
    ("bad_datagrams, share: 0.5", trouble("damaged"), 0.5),
    ("other_version, version: '3.0'", trouble("version"), Version(3, 0)),
    ("outdated, by: 2, frames: 3", trouble("outdated_s"), 2.0),
    ("untracked, robot: green", bodies, shown(valid=False)),
    ("jump, robot: green, by: [300, -100]", bodies, shown(0.8, z=-0.4)),
    ("ghost, robot: green, by: [5, 0]", lambda lab: lab.camera.tracked[0].step, (5.0, 0.0)),
    ("repeat", lambda lab: [body.repeats for body in lab.camera.tracked], [True, True]),
    ("lifted, robot: green, height: 900", bodies, shown(height=0.9)),
    ("tipped, robot: green, angle: 0.5", lambda lab: lab.camera.tracked[0].roll, 0.5),
    ("swap, robot: green, other: blue", lambda lab: bodies(lab)[0][2:5], (0.5, 0.06, -1.5)),
    ("nan, robot: green", lambda lab: math.isnan(bodies(lab)[0][2]), True),
    ("bad_quaternion, robot: green", lambda lab: round(math.hypot(*bodies(lab)[0][5:]), 5), 0.5),
    ("twin_id, robot: blue, other: green", lambda lab: [b[0] for b in bodies(lab)], [1, 1]),
]
M3PI = [
    ("veer, robot: green, counts: [80, 40]", green("veer"), (80, 40)),
    ("wheel_stuck, robot: green, wheel: left", green("stuck"), (True, False)),
    ("wheel_stuck, robot: green, wheel: both", green("stuck"), (True, True)),
    ("loss, share: 0.25", lambda lab: lab.actuator.radio.loss, 0.25),
    ("off, robot: green", green("powered"), False),
    ("low_battery, robot: green, millivolts: 3900", green("battery_mv"), 3900),
]
FIELD = [
    ("off", lambda lab: lab.actuator.driver.powered, False),
    ("low_supply, millivolts: 9000", lambda lab: lab.actuator.driver.supply_mv, 9000),
    ("hot, celsius: 85", lambda lab: lab.actuator.driver.temperature_dc, 850),
    ("mute", lambda lab: lab.actuator.driver.mute, True),
]
TAGS = [("untracked, robot: green", lambda lab: lab.camera.renderer.hidden, {1})]
ROWS = [
    *((SPEC, *row) for row in OPTITRACK + M3PI),
    *((FIELD_SPEC, *row) for row in FIELD),
    *((APRILTAG_SPEC, *row) for row in TAGS),
]


def begun(folder, fault, spec=SPEC):
    """A lab that is not open, its script's one fault, and the device that has it."""
    lab = emulated(folder, script=f"faults: [{{fault: {fault}}}]", spec=spec)
    (found,) = lab.injector.faults
    return lab, found, lab._device_of(found)


@pytest.mark.parametrize(("spec", "fault", "read", "during"), ROWS, ids=[row[1] for row in ROWS])
def test_a_fault_changes_its_device_and_takes_it_back(tmp_path, spec, fault, read, during):
    if spec == APRILTAG_SPEC:
        pytest.importorskip("cv2")
    lab, found, device = begun(tmp_path, fault, spec)
    before = read(lab).copy() if isinstance(read(lab), set) else read(lab)
    assert before != during
    undo = found.begin(device)
    assert read(lab) == during
    undo()
    assert read(lab) == before


@pytest.mark.parametrize(
    ("fault", "gained"), [("clock_jump, by: -0.5", -0.5), ("clock_rate, rate: 3", 2.0)]
)
def test_the_servers_clock_is_set_or_runs_wrongly(tmp_path, fault, gained):
    lab, found, device = begun(tmp_path, fault)
    then = lab.timeline.now_ns + SECOND
    before = ticks(then)(lab)
    found.begin(device)
    assert (ticks(then)(lab) - before) / 1e7 == pytest.approx(gained)


def test_a_robot_with_another_number_obeys_that_one(tmp_path):
    lab, found, device = begun(tmp_path, "wrong_id, robot: green, id: 1")
    found.begin(device)
    robot = lab.actuator.robot("green")
    robot.hear(encode_command(BroadcastCommand(1, Flag.RUN, ((10, 10), (20, 20)))))
    assert robot.counts() == (20, 20)


def test_every_fault_is_in_the_table_of_a_device_with_when_it_shows():
    optitrack = Sides.of("optitrack", "m3pi-xbee").faults
    assert len(optitrack) == 29
    at_once = {name for name, kind in optitrack.items() if kind.visible is Visible.AT_ONCE}
    assert {"mark", "unplug", "clock_jump", "veer"} <= at_once
    assert optitrack["freeze"].visible is Visible.SENT
    assert optitrack["jump"].visible is Visible.EXPOSED


@pytest.mark.slow
def test_robots_are_put_back_and_restarted(tmp_path):
    told = []
    lab = emulated(tmp_path, replace_after=0.1, tell=lambda event, facts: told.append(event))
    with lab:
        robot = lab.actuator.robot("green")
        robot.hear(encode_command(BroadcastCommand(1, Flag.RUN, RUN)))
        turn_until(lab, lambda: robot.x > 510)
        robot.hear(encode_command(BroadcastCommand(2, Flag.EMERGENCY_STOP)))
        turn_until(lab, lambda: not lab.camera.tracked[0].tracked)
        assert not robot.powered
        turn_until(lab, lambda: "placed" in told)
        assert (robot.x, robot.y, robot.heading) == (500, 500, 0.5)
        robot.hear(encode_command(BroadcastCommand(3, Flag.RUN, RUN)))
        assert robot.counts() == (60, 60)


def open_files():
    return {path.name for path in Path("/proc/self/fd").iterdir()}


def test_nothing_is_left_open(tmp_path):
    before = open_files()
    for _ in range(3):
        with emulated(tmp_path) as lab:
            lab.actuator.plugged(False)
            lab.actuator.plugged(True)
    assert open_files() == before
    assert [path.name for path in tmp_path.iterdir()] == ["record.jsonl"]
