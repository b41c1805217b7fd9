"""Tests of an emulated lab: what it records and reports, and how it puts robots on their starts."""

import json
import math

import pytest
from testkit.emulator.lab_processes import script_of
from testkit.lab_specs import SPEC
from tetractl_emulator.emulated_lab import CARRIED_NS, EmulatedLab
from tetractl_emulator.memory_wires import MemoryNetwork
from tetractl_emulator.sides import Options
from tetractl_emulator.virtual_lab import LabClock, VirtualLoop, create_memory_wires

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.errors import SpecError, TetractlError
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.cobs import Flag
from tetractl.spec.load import parse_spec
from tetractl.spec.plants import get_lab

SETUP = parse_spec(SPEC, "lab.yaml").experiment.setup
OPEN = []


@pytest.fixture(autouse=True)
def close():
    """Close the records of the labs that a test has opened."""
    yield
    while OPEN:
        OPEN.pop().close()


class Bench:
    """An emulated lab in virtual time, with what it reports."""

    def __init__(self, folder=None, script="", process_of=None, spec=SPEC, **options):
        loaded = parse_spec(spec, "lab.yaml")
        lab = get_lab(loaded.experiment, loaded.name)
        self.record = folder / "record.jsonl" if folder else None
        self.reported = []
        clock = LabClock()
        self.lab = EmulatedLab(
            lab,
            loaded.experiment.setup,
            script_of(script, lab),
            Options(address=None, record=self.record, **options),
            report=lambda event, facts: self.reported.append((event, facts)),
            make_loop=VirtualLoop,
            wires=create_memory_wires(MemoryNetwork(), clock),
            process_of=process_of,
        )
        self._sequence = 0

    def opened(self):
        self.lab.open()
        OPEN.append(self.lab)
        return self

    @property
    def robots(self):
        return self.lab.actuator.bodies

    def run(self, seconds, *counts):
        """Let time pass, while each robot is sent counts of both wheels."""
        for _ in range(round(seconds / 0.1)):
            if counts:
                self._sequence = (self._sequence + 1) % 256
                command = BroadcastCommand(self._sequence, Flag.RUN, counts)
                for robot in self.robots:
                    robot.receive(encode_command(command))
            self.lab.timeline.run_to(self.lab.timeline.now_ns + SECOND // 10)

    def poses(self):
        return [(body.x, body.y, body.heading) for body in self.robots]

    def events(self, *names):
        lines = map(json.loads, self.record.read_text().splitlines())
        return [line for line in lines if line["event"] in names]

    def said(self, *names):
        return [event for event, _ in self.reported if event in names]


STARTS = [
    pytest.approx((x * 1000 * SETUP.metres, y * 1000 * SETUP.metres, heading))
    for x, y, heading in SETUP.starts.array().tolist()
]
GREEN, BLUE = SETUP.names
AHEAD = (20, 20)
STILL = (0, 0)
SLOW = (1, 1)  # the wheels need longer than a tick to move visibly


IN_CM = SPEC.replace("length: mm", "length: cm").replace("2000", "200").replace("1500", "150")
IN_CM = IN_CM.replace("500", "50").replace("180}", "18}").replace("speed: 200", "speed: 20")
IN_CM = IN_CM.replace("radius: 40", "radius: 4")


def test_robots_stand_on_the_starts_of_the_spec_whatever_its_unit():
    assert Bench().poses() == STARTS
    assert Bench(spec=IN_CM).poses() == STARTS


@pytest.mark.parametrize(
    ("robot", "start", "heading"),
    [
        ("start: [600, 700], heading: 1.2", (600, 700), 1.2),
        ("start: [600, 700]", (600, 700), None),
        ("heading: 0.0", None, 0.0),
        ("heading: -1.2", None, -1.2),
    ],
)
def test_a_script_puts_one_robot_elsewhere_or_turns_it(robot, start, heading):
    bench = Bench(script=f"emulation: {{robots: [{{name: {BLUE}, {robot}}}]}}")
    green, blue = bench.poses()
    x, y, turned = SETUP.starts.array()[1]
    mm = 1000 * SETUP.metres
    x, y = start or (x, y)
    turned = turned if heading is None else heading
    assert green == STARTS[0]
    assert blue == pytest.approx((x * mm, y * mm, turned))


def test_cells_that_trials_choose_are_put_nowhere():
    bench = Bench()
    bench.robots[0].place(1.0, 2.0, 3.0)
    chosen = Bench(trials_choose_robots=True)
    assert chosen.poses() == [(0.0, 0.0, 0.0)] * 2


@pytest.mark.parametrize(
    "script",
    [
        "emulation: {robots: [{name: red, heading: 0}]}",
        "emulation: {actuator: {robots: [{name: red}]}}",
        "faults: [{fault: untracked, robot: red}]",
        f"faults: [{{fault: swap, robot: {GREEN}, other: red}}]",
    ],
)
def test_a_script_that_names_no_robot_of_the_spec_is_refused(script):
    with pytest.raises(SpecError, match="names red, which is not a robot") as error:
        Bench(script=script)
    assert f"{GREEN}, {BLUE}" in error.value.hint


def test_what_is_ready_is_recorded_and_reported(tmp_path):
    bench = Bench(tmp_path).opened()
    ((event, facts),) = bench.reported
    assert event == "ready"
    assert facts["emulation"] is True
    assert facts["robots"] == [GREEN, BLUE]
    assert facts["port"] == bench.lab.port != ""
    (ready,) = bench.events("ready")
    assert ready["camera"] == facts["camera"]


def test_a_record_that_cannot_be_written_is_an_error_of_one_line(tmp_path):
    with pytest.raises(TetractlError, match=r"record.jsonl: cannot write the record"):
        Bench(tmp_path / "none").opened()


def test_nothing_is_recorded_without_a_record():
    bench = Bench().opened()
    bench.run(0.5, AHEAD, STILL)
    bench.lab.close()
    bench.lab.close()
    assert bench.said("run") == ["run"]


def test_each_exposure_is_recorded_with_the_true_poses(tmp_path):
    bench = Bench(tmp_path).opened()
    bench.run(0.5)
    rows = bench.events("truth")
    assert [row["exposure"] for row in rows] == [*range(1, len(rows) + 1)]
    assert len(rows) == pytest.approx(0.5 * 120, abs=2)
    assert rows[-1]["poses"] == [pytest.approx(start.expected, abs=1e-3) for start in STARTS]
    assert rows[-1]["wheels"] == [[0.0, 0.0]] * 2
    assert all(0 <= unseen_ms < 20 for unseen_ms in rows[-1]["unseen_ms"])
    assert rows[-1]["t_ns"] == pytest.approx(0.5 * SECOND, abs=SECOND / 120)


def test_a_hidden_robot_is_unseen_for_longer_and_longer(tmp_path):
    script = f"faults: [{{fault: untracked, robot: {BLUE}, since: start}}]"
    bench = Bench(tmp_path, script).opened()
    bench.run(0.5)
    green_ms, blue_ms = bench.events("truth")[-1]["unseen_ms"]
    assert green_ms < 20
    assert blue_ms > 480


def test_a_fault_is_recorded_and_reported_as_it_begins_and_ends(tmp_path):
    first = f"{{fault: untracked, robot: {GREEN}, since: start, at: 0.3, for: 0.1}}"
    script = f"faults: [{first}, {{fault: freeze, since: start, at: 0.1, for: 0.1}}]"
    bench = Bench(tmp_path, script).opened()
    bench.run(0.7)
    rows = [(e["name"], e["phase"], e["robot"], e["row"]) for e in bench.events("fault")]
    frozen, hidden = ("freeze", None, 1), ("untracked", GREEN, 0)
    assert rows == [
        (name, phase, robot, row)
        for name, robot, row in (frozen, hidden)
        for phase in ("start", "end")
    ]
    assert bench.said("fault") == ["fault"] * 4


class Process:
    """Stands for the process that drives the robots; it keeps the signals that it gets."""

    def __init__(self, lab):
        self.signals = []

    def signal(self, name):
        self.signals.append(name)


def test_each_fault_acts_on_its_own_device_or_on_the_process(tmp_path):
    off = f"{{fault: 'off', robot: {BLUE}, since: start}}"
    script = f"faults: [{off}, {{fault: signal, signal: TERM, since: start, at: 0.1}}]"
    bench = Bench(tmp_path, script, process_of=Process).opened()
    bench.run(0.5)
    assert bench.lab._process.signals == ["TERM"]
    assert [robot.powered for robot in bench.robots] == [True, False]


def test_a_run_begins_with_the_first_command_that_drives_a_robot(tmp_path):
    bench = Bench(tmp_path).opened()
    bench.run(0.3, STILL, STILL)
    assert bench.events("run") == []
    bench.run(0.3, STILL, AHEAD)
    bench.run(0.5)
    bench.run(0.3, AHEAD, STILL)
    (run,) = bench.events("run")
    assert run["t_ns"] == pytest.approx(0.3 * SECOND, abs=0.01 * SECOND)
    assert bench.said("run") == ["run"]


def test_faults_that_wait_for_a_run_or_a_stop_begin_then(tmp_path):
    script = "faults: [{fault: freeze, for: 0.1}, {fault: no_frames, since: stop, for: 0.1}]"
    bench = Bench(tmp_path, script).opened()
    bench.run(0.3, STILL, STILL)
    bench.run(0.3, AHEAD, STILL)
    bench.run(1.0)
    starts = [e for e in bench.events("fault") if e["phase"] == "start"]
    assert [event["name"] for event in starts] == ["freeze", "no_frames"]
    run_s, stop_s = (event["t_ns"] / SECOND for event in starts)
    assert run_s == pytest.approx(0.3, abs=0.02)
    # the newest command is obeyed for the watchdog's 0.25 s after 0.5 s
    assert stop_s == pytest.approx(0.75, abs=0.02)


def test_each_robot_that_begins_or_ceases_to_move_is_recorded_once(tmp_path):
    bench = Bench(tmp_path).opened()
    bench.run(0.5, STILL, AHEAD)
    bench.run(1.5)
    rows = [(event["name"], event["moving"]) for event in bench.events("robot")]
    assert rows == [(BLUE, True), (BLUE, False)]
    assert bench.said("moving", "rest") == ["moving", "rest"]


def test_all_are_at_rest_only_once_the_last_one_stands():
    bench = Bench().opened()
    bench.run(0.3, AHEAD, AHEAD)
    bench.run(0.5, STILL, AHEAD)
    assert bench.said("moving", "rest") == ["moving"]
    bench.run(1.5)
    assert bench.said("moving", "rest") == ["moving", "rest"]


def test_robots_are_carried_to_their_starts_after_a_run_and_a_rest(tmp_path):
    bench = Bench(tmp_path, replace_after=0.5).opened()
    bench.run(2.0)
    assert bench.events("placed") == []  # no run, no carrying
    bench.run(1.0, AHEAD, AHEAD)
    driven = bench.poses()
    bench.run(3.0)
    (placed,) = bench.events("placed")
    rests_ns = [e["t_ns"] for e in bench.events("robot") if not e["moving"]]
    waited_ns = placed["t_ns"] - max(rests_ns)
    assert waited_ns == pytest.approx(0.5 * SECOND + CARRIED_NS, abs=4 * MILLISECOND)
    assert driven != STARTS
    assert bench.poses() == STARTS
    assert bench.said("placed") == ["placed"]
    assert all(robot.powered for robot in bench.robots)
    assert not bench.lab.injector.acting.robots_are_carried


def test_a_rest_before_a_slow_run_does_not_count_as_one_after_it():
    bench = Bench(replace_after=0.5).opened()
    bench.run(1.0)
    bench.run(0.3, SLOW, SLOW)
    assert bench.said("run", "placed") == ["run"]
    assert not bench.lab.injector.acting.robots_are_carried


def test_while_robots_are_carried_they_are_off_and_no_camera_shows_them(tmp_path):
    bench = Bench(tmp_path, replace_after=0.2).opened()
    bench.run(0.3, AHEAD, STILL)
    while not bench.lab.injector.acting.robots_are_carried:
        bench.run(0.1)
    assert not any(robot.powered for robot in bench.robots)
    bench.run(0.3)
    assert min(bench.events("truth")[-1]["unseen_ms"]) > 150


def test_robots_are_carried_after_each_run():
    bench = Bench(replace_after=0.2).opened()
    for _ in range(2):
        bench.run(0.5, AHEAD, STILL)
        bench.run(2.5)
    assert bench.said("run", "placed") == ["run", "placed"] * 2


def test_robots_stay_where_they_are_unless_they_are_to_be_carried():
    bench = Bench().opened()
    bench.run(0.5, AHEAD, STILL)
    bench.run(3.0)
    assert bench.said("placed") == []
    assert bench.poses() != STARTS
    assert math.dist(bench.poses()[0][:2], STARTS[0].expected[:2]) > 20


def test_the_state_of_the_guard_is_recorded_when_it_or_its_reason_changes(tmp_path):
    bench = Bench(tmp_path).opened()
    for state, reason in (("wait", ""), ("wait", ""), ("run", ""), ("abort", "a"), ("abort", "b")):
        bench.lab.note_guard_state(state, reason)
    rows = [(event["state"], event["reason"]) for event in bench.events("guard")]
    assert rows == [("wait", ""), ("run", ""), ("abort", "a"), ("abort", "b")]


def test_the_record_ends_with_the_counts_of_both_devices(tmp_path):
    with Bench(tmp_path).lab as lab:
        lab.timeline.run_to(SECOND)
        lab.loop.worst_lag_ns = 7_500_000
    (line,) = [
        json.loads(text)
        for text in (tmp_path / "record.jsonl").read_text().splitlines()
        if '"end"' in text
    ]
    assert line["event"] == "end"
    assert line["garbled"] == 0
    assert line["worst_lag_ms"] == 7.5
