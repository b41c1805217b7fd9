"""`tetractl lab check`, `stop`, `calibrate`, and what `tetractl run --plant lab` adds, emulated."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from support.lab_processes import PATIENCE_S, ROOT, SMALL, SPEC, TETRACTL, Emulator, flags
from support.terminal import Terminal

from tetractl.core.clock import MonotonicClock
from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import calibrated, on_plant
from tetractl.lab.actuators.m3pi.broadcast import Flag, decode_command
from tetractl.lab.actuators.xbee.framing import Decoder
from tetractl.lab.cameras.optitrack.camera import OptitrackCamera
from tetractl.lab.cameras.optitrack.replay import replay_cameras
from tetractl.lab.cobs import Splitter
from tetractl.log.format.wire import read_wire
from tetractl.log.read.reader import read_trial

UNEVEN = """
about: robots that differ from their spec
emulation:
  camera: {robots: [{name: green, heading_offset: 0.3}]}
  actuator:
    robots:
      - name: green
        swap: true
        left: {gain_mm: 7.1, dead_zone: 9, invert: true}
        right: {gain_mm: 8.2, dead_zone: 12}
        radius_mm: 43
"""


@pytest.fixture
def lab(tmp_path):
    """Start an emulated lab; returns it and the settings that lead to it."""
    made = []

    def start(script="", *options):
        if script:
            (tmp_path / "script.yaml").write_text(script)
            options = (*options, "--script", str(tmp_path / "script.yaml"))
        emulator = Emulator(tmp_path, SMALL, *options)
        made.append(emulator)
        ready = emulator.wait_for("ready")
        return emulator, (
            *SMALL,
            f"lab.camera.command_port={ready['command_port']}",
            f"lab.actuator.port={ready['port']}",
        )

    yield start
    for emulator in made:
        emulator.close()


def tetractl(folder, *words):
    return subprocess.run(
        [TETRACTL, *words],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )


def test_check_says_ready_and_moves_nothing(lab, tmp_path):
    emulator, settings = lab()
    done = tetractl(tmp_path, "lab", "check", str(SPEC), "--json", *flags(settings))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["ready"]
    assert [robot["name"] for robot in found["robots"]] == ["green", "blue", "red"]
    for robot in found["robots"]:
        assert robot["tracked"]
        assert robot["answers"]
        assert robot["off_mm"] < 1
        assert 4 < robot["battery_v"] < 6
    assert 100 < found["camera_rate_hz"] < 140
    assert 0 < found["latency_ms"]["p50"] <= found["latency_ms"]["max"]
    _, record = emulator.end()
    assert not [event for event in record if event["event"] == "run"]


def test_check_says_who_is_off_and_how_far(lab, tmp_path):
    _, settings = lab()
    moved = ("robots.0.start=[1000, 800]", "robots.2.heading=1")
    done = tetractl(tmp_path, "lab", "check", str(SPEC), *flags((*settings, *moved)))
    assert done.returncode == 1
    assert "problem: green is 100 mm from its start" in done.stdout
    assert "problem: red is turned by -1.00 rad from its start heading" in done.stdout
    assert done.stdout.rstrip().endswith("not ready")


def test_check_prints_the_names_that_the_cameras_have_beside_the_one_wanted(lab, tmp_path):
    _, settings = lab()
    sets = flags((*settings, "lab.camera.robots.green.body=Gren"))
    done = tetractl(tmp_path, "lab", "check", str(SPEC), *sets)
    assert done.returncode == 1
    assert (
        "problem: the cameras know no rigid body 'Gren', wanted for green; did you mean 'green'?; "
        "they have 'green' (id 1); 'blue' (id 2); 'red' (id 3)"
    ) in done.stdout


@pytest.mark.parametrize(
    ("actuator", "says"),
    [
        ("hardware: 0x7F44", "the module (HV 7F44, VR 10EC) is not known here: does it run 802"),
        ("explicit: true", "frames of type 0x91, which are not read: set AO in it to 0 or 2"),
    ],
)
def test_check_says_what_is_odd_of_the_radio(lab, tmp_path, actuator, says):
    script = f"about: an odd radio\nemulation: {{actuator: {{{actuator}}}}}"
    _, settings = lab(script)
    command = ("lab", "check", str(SPEC), *flags(settings))
    done = tetractl(tmp_path, *command)
    assert done.returncode == 1
    assert says in done.stdout
    if "hardware" in actuator:
        assert "not answered: add --yes where nobody can be asked" in done.stderr
        done = tetractl(tmp_path, *command, "--yes")
        assert done.returncode == 0, done.stdout
        assert f"warning: {tmp_path / 'radio'}: the module" in done.stdout
        with Terminal([TETRACTL, *command], tmp_path, columns=200) as terminal:
            terminal.expect(r"802\.15\.4 firmware\? \[y/N\]")
            terminal.press("n\n")
            assert terminal.finish() == 1


def test_a_robot_not_on_its_start_is_not_driven(lab, tmp_path):
    emulator, settings = lab()
    sets = flags((*settings, "robots.1.start=[900, 1300]"))
    done = tetractl(tmp_path, "run", str(SPEC), "--plant", "lab", "--yes", "--out", "logs", *sets)
    assert done.returncode == 1
    assert "error: blue is 100 mm from its start" in done.stderr
    _, record = emulator.end()
    assert not [event for event in record if event["event"] == "run"]
    assert list((tmp_path / "logs").iterdir()) == []


def test_stop_latches_every_robot_by_port_alone(lab, tmp_path):
    _, settings = lab()
    done = tetractl(tmp_path, "lab", "stop", "--port", str(tmp_path / "radio"))
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("sent 20 stops on ")
    done = tetractl(tmp_path, "lab", "check", str(SPEC), *flags(settings))
    assert done.returncode == 1
    for name in ("green", "blue", "red"):
        assert f"problem: {name} is emergency-stopped" in done.stdout


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["stop"], 2, "name a SPEC or a --port"),
        (["stop", "--port", "nowhere"], 1, "nowhere: there is no such port"),
        (["stop", "--port", "x", "--mode", "loud"], 2, "--mode"),
        (["check", str(SPEC.with_name("three_m3pi.yaml"))], 2, "has no lab"),
        (["calibrate", str(SPEC)], 2, "robots would move"),
        (["calibrate", str(SPEC), "--robot", "pink", "--yes"], 2, "has no such robot"),
    ],
)
def test_bad_usage_is_one_clear_line(tmp_path, words, code, says):
    done = tetractl(tmp_path, "lab", *words)
    assert done.returncode == code
    assert done.stderr.startswith("error: ")
    assert says in done.stderr


def test_lab_options_of_run_are_checked(tmp_path):
    done = tetractl(tmp_path, "run", str(SPEC), "--record-wire", "wire")
    assert (done.returncode, done.stdout) == (2, "")
    assert "a simulation has no wire" in done.stderr
    done = tetractl(tmp_path, "run", str(SPEC), "--plant", "lab", "--jobs", "2")
    assert done.returncode == 2
    assert "one trial at a time" in done.stderr


def test_robots_move_only_where_that_is_asked_for(lab, tmp_path):
    """Regression: `rerun LABLOG </dev/null` set robots moving, as did `run --plant lab`."""
    emulator, settings = lab("", "--replace-after", "0.5")
    sets = flags((*settings, "controller.steps_max=2", "lab.limits.placing=30"))

    def said(*words):
        done = tetractl(tmp_path, *words)
        assert emulator.runs() == started
        return done

    started = 0
    refused = said("run", str(SPEC), "--plant", "lab", "--out", "first", *sets)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "error: robots would move" in refused.stderr
    assert not (tmp_path / "first").exists()
    started = 1
    moved = said("run", str(SPEC), "--plant", "lab", "--yes", "--out", "first", *sets)
    assert moved.returncode == 0

    again_from = ("rerun", "first/trial-000.mcap", "--out")
    again = said(*again_from, "simulated")
    assert again.returncode == 0, again.stderr
    assert "the log is of the lab, the new one simulated" in again.stderr
    assert read_trial(tmp_path / "simulated" / "trial-000.mcap").start.plant.simulated
    refused = said(*again_from, "lab", "--plant", "lab")
    assert (refused.returncode, refused.stdout) == (2, "")
    started = 2
    again = said(*again_from, "lab", "--plant", "lab", "--yes")
    assert again.returncode == 0, again.stderr
    assert "the log is of the lab, the new one of the lab" in again.stderr


def test_calibrate_finds_what_the_robot_truly_is_and_the_log_attaches_it(lab, tmp_path):
    _, settings = lab(UNEVEN, "--replace-after", "4")
    done = tetractl(
        tmp_path, "lab", "calibrate", str(SPEC), "--robot", "green", "--yes", *flags(settings)
    )
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "calibration.yaml").read_text()
    lab = calibrated(on_plant(load_spec(SPEC), "lab").experiment, text, "calibration.yaml").plant
    green = lab.actuator.robot("green")
    assert green.swap
    assert (green.left.invert, green.right.invert) == (True, False)
    assert green.left.gain_mm == pytest.approx(7.1, rel=0.06)
    assert green.right.gain_mm == pytest.approx(8.2, rel=0.06)
    assert abs(green.left.dead_zone - 9) <= 1
    assert abs(green.right.dead_zone - 12) <= 1
    assert green.radius_mm == pytest.approx(43, rel=0.05)
    assert lab.camera.heading_offset("green") == pytest.approx(0.3, abs=0.03)
    sets = flags(
        (
            *settings,
            f"lab.calibration={tmp_path / 'calibration.yaml'}",
            "lab.limits.placing=60",
            "controller.steps_max=3",
        )
    )
    done = tetractl(tmp_path, "run", str(SPEC), "--plant", "lab", "--yes", "--out", "logs", *sets)
    assert done.returncode == 0, done.stderr
    trial = read_trial(tmp_path / "logs" / "trial-000.mcap")
    assert trial.experiment.plant.actuator.robots[0].radius_mm == green.radius_mm
    assert attachment(tmp_path / "logs" / "trial-000.mcap", "calibration.yaml") == text


def attachment(path, name):
    from mcap.reader import make_reader

    with path.open("rb") as file:
        (found,) = [a for a in make_reader(file).iter_attachments() if a.name == name]
        return found.data.decode()


def test_a_recorded_wire_gives_the_same_poses_and_commands_again(lab, tmp_path):
    _, settings = lab()
    words = ("--plant", "lab", "--yes", "--out", "logs", "--record-wire", "wire", *flags(settings))
    done = tetractl(tmp_path, "run", str(SPEC), *words)
    assert done.returncode == 0, done.stderr
    trial = read_trial(tmp_path / "logs" / "trial-000.mcap")
    passages = list(read_wire(tmp_path / "wire" / "trial-000.wire"))

    loaded = on_plant(load_spec(SPEC, settings), "lab").experiment
    seen = {}
    camera = OptitrackCamera(loaded.plant.camera, loaded.setup, MonotonicClock())
    stream = camera.stream
    stream._on_frame = lambda frame: seen.setdefault(frame.number, frame)
    replay_cameras(passages, stream)
    assert stream.counts.bad == 0
    for number, sampled_ns, poses in zip(trial.frames, trial.mocap_ns, trial.mocap, strict=True):
        again = seen[number]
        assert again.sampled_ns == sampled_ns
        np.testing.assert_array_equal([(p.x, p.y) for p in again.poses], poses[:, :2])

    decoder, splitter = Decoder(), Splitter()
    frames = [
        decode_command(cut)
        for passage in passages
        if passage.wire == "radio" and not passage.received
        for frame in decoder.feed(passage.data)
        if hasattr(frame, "destination")
        for cut in splitter.feed(frame.data)
    ]
    driven = [frame for frame in frames if frame.flags & Flag.RUN]
    moves = [command for command in trial.commands if command.direction is not None]
    assert len(driven) == len(moves)
    plant = on_plant(load_spec(SPEC, settings), "lab").experiment.plant
    for frame, command in zip(driven, moves, strict=True):
        left = [pair[0] * plant.actuator.robots[0].left.gain_mm for pair in frame.wheels]
        np.testing.assert_allclose(command.left, left, rtol=1e-9)


def test_space_is_the_operators_emergency_stop(lab, tmp_path):
    emulator, settings = lab()
    sets = flags((*settings, "lab.limits.placing=30", "robots.0.target=[1500, 500]"))
    command = [TETRACTL, "run", str(SPEC), "--plant", "lab", "--out", "logs", "--quiet", *sets]
    with Terminal(command, tmp_path, columns=100) as terminal:
        terminal.expect("SPACE or ESC: EMERGENCY STOP")
        terminal.expect("press Enter to go")
        terminal.press("\r")
        emulator.wait_for("run")
        terminal.press(" ")
        assert terminal.finish() == 1
        assert "emergency stop by the operator" in terminal.raw
        assert terminal.settings() == terminal.before
    _, record = emulator.end()
    stops = [e for e in record if e["event"] == "command" and e["flags"] & 2]
    assert len(stops) >= 10
    last = [e for e in record if e["event"] == "robot"][-3:]
    assert not any(event["moving"] for event in last)


LONG = ("controller.steps_max=40", "lab.limits.placing=30", "robots.0.target=[1500, 500]")
SLAVES = (
    "lab.actuator.protocol={type: slave, accept_no_watchdog: true}",
    *(f"lab.actuator.robots.{i}.address={i + 1}" for i in range(3)),
)


@pytest.mark.parametrize("protocol", [(), SLAVES], ids=["watchdog", "no watchdog"])
@pytest.mark.parametrize("hangs", [False, True], ids=["closed", "hangs"])
def test_a_terminal_that_is_closed_or_hangs_stops_no_stop(lab, tmp_path, protocol, hangs):
    """Regression: a closed terminal left robots without a watchdog driving, and the log torn."""
    emulator, settings = lab("", *flags(protocol))
    sets = flags((*settings, *protocol, *LONG))
    command = [TETRACTL, "run", str(SPEC), "--plant", "lab", "--out", "logs", *sets]
    with Terminal(command, tmp_path, columns=100) as terminal:
        terminal.expect("press Enter to go")
        terminal.press("\r")
        emulator.wait_for("run")
        if hangs:  # the live view fills it at once
            terminal.fill()
            terminal.process.send_signal(signal.SIGINT)
        else:
            terminal.close()
        code = terminal.process.wait(PATIENCE_S)
    assert code == 130 if hangs else code in (1, 130)  # the signal or the lost key comes first
    trial = read_trial(tmp_path / "logs" / "trial-000.mcap")
    assert trial.damage is None
    assert trial.result.outcome == ("interrupted" if code == 130 else "aborted")
    assert len(trial.steps) < 40
    _, record = emulator.end()
    last = [e for e in record if e["event"] == "robot"][-3:]
    assert not any(event["moving"] for event in last)


def test_no_line_of_the_runner_knows_that_a_lab_is_emulated():
    folder = ROOT / "tetractl"
    for path in folder.rglob("*.py"):
        if "emulat" in path.name or path.parent.name == "emulate":
            continue
        text = path.read_text()
        for name in ("lab_emulate", "lab.emulate", "is_emulated"):  # the last reads what it says
            text = text.replace(name, "")
        lines = [line for line in text.splitlines() if "emulat" in line and "import" in line]
        assert lines == [], path
    assert sys.version_info >= (3, 11)
