"""Tests of `tetractl lab check`, `stop`, `calibrate` and `run --plant lab`, in virtual time."""

import contextlib
import json

import pytest
from testkit.cli import tetractl
from testkit.emulator.lab_processes import SMALL, SPEC, flags
from testkit.emulator.virtual_lab import virtual_lab
from tetractl_emulator.script import parse_script

from tetractl.core.clock import SECOND
from tetractl.lab.cobs import Flag
from tetractl.log.read.reader import read_trial
from tetractl.spec.lab_section import entry
from tetractl.spec.load import load_spec
from tetractl.spec.plants import apply_calibration, select_plant

pytestmark = pytest.mark.slow

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
    """Return what makes an emulated lab of a script."""
    with contextlib.ExitStack() as stack:

        def start(script="about: nothing goes wrong", replace_after=None):
            play = parse_script(script, "script.yaml")
            how = {"script": play, "replace_after": replace_after, "ahead_s": 0.5}
            return stack.enter_context(virtual_lab(tmp_path, *SMALL, spec=SPEC, **how))

        yield start


def test_check_says_ready_and_moves_nothing(lab, tmp_path):
    emulated = lab()
    settings = flags(emulated.settings)
    done = tetractl(tmp_path, "lab", "check", str(SPEC), "--json", *settings).ok()
    printed = json.loads(done.stdout)
    assert printed["ready"]
    assert [robot["name"] for robot in printed["robots"]] == ["green", "blue", "red"]
    for robot in printed["robots"]:
        assert robot["tracked"]
        assert robot["answers"]
        assert robot["off_mm"] < 1
        assert 4 < robot["battery_v"] < 6
    assert 100 < printed["camera_rate_hz"] < 140
    assert 0 < printed["latency_ms"]["p50"] <= printed["latency_ms"]["max"]
    assert emulated.events("run") == []


def test_check_says_who_is_off_and_how_far(lab, tmp_path):
    settings = lab().settings
    moved = ("robots.0.start=[955, 800]", "robots.1.start=[945, 1200]", "robots.2.heading=0.4")
    done = tetractl(tmp_path, "lab", "check", str(SPEC), *flags((*settings, *moved)))
    assert done.returncode == 1
    assert "problem: green is 55 mm from its start" in done.stdout
    assert "problem: red is turned by -0.40 rad from its start heading" in done.stdout
    assert "blue is" not in done.stdout
    assert done.stdout.rstrip().endswith("not ready")


def test_a_robot_not_on_its_start_is_not_driven(lab, tmp_path):
    emulated = lab()
    sets = flags((*emulated.settings, "robots.1.start=[900, 1300]"))
    done = tetractl(tmp_path, "run", str(SPEC), "--plant", "lab", "--yes", "--out", "logs", *sets)
    assert done.returncode == 1
    assert "error: blue is 100 mm from its start" in done.stderr
    assert emulated.events("run") == []
    assert list((tmp_path / "logs").iterdir()) == []


def test_stop_latches_every_robot_by_port_alone(lab, tmp_path, monkeypatch):
    emulated = lab()
    monkeypatch.setattr("tetractl.cli.lab.MonotonicClock", lambda: emulated.clock)
    done = tetractl(tmp_path, "lab", "stop", "--port", str(tmp_path / "radio")).ok()
    assert done.stdout.startswith("sent 10 stops on ")
    done = tetractl(tmp_path, "lab", "check", str(SPEC), *flags(emulated.settings))
    assert done.returncode == 1
    for name in ("green", "blue", "red"):
        assert f"problem: {name} is emergency-stopped" in done.stdout


WRONG_SPECS = {
    "a controller's field": (("type: mpc", "type: mpc\n  typo: 1"), "controller.typo"),
    "a kind of camera": (("type: optitrack", "type: sonar"), "lab.camera.type"),
    "a robot's start": (("start: [900, 800]", "start: [9000, 800]"), "robots.0.start"),
    "a robot without an entry": (("      - {name: red, index: 2}\n", ""), "lab.actuator.robots"),
    "no identified file": (("name: three", "identified: away.yaml\nname: three"), "away.yaml"),
}


def stops_by_spec(emulated, folder, monkeypatch, replaced, *settings):
    """Run `lab stop` with a spec of the emulated lab in which texts are replaced; return what it
    printed, and the number of stops that the radio transmitted."""
    monkeypatch.setattr("tetractl.cli.lab.MonotonicClock", lambda: emulated.clock)
    text = SPEC.read_text().replace("/dev/ttyUSB0", str(folder / "radio"))
    for old, new in replaced:
        assert old in text
        text = text.replace(old, new)
    (folder / "lab.yaml").write_text(text)
    done = tetractl(folder, "lab", "stop", "lab.yaml", *flags(settings))
    emulated.clock.sleep_until(emulated.clock.now() + SECOND)
    commands = emulated.events("command")
    return done, sum(bool(command["flags"] & Flag.EMERGENCY_STOP) for command in commands)


@pytest.mark.parametrize("where", WRONG_SPECS)
def test_stop_needs_no_more_of_a_spec_than_its_actuator(lab, tmp_path, monkeypatch, where):
    """Regression: not one stop was sent if any part of the spec was wrong."""
    replaced, field = WRONG_SPECS[where]
    done, count = stops_by_spec(lab(), tmp_path, monkeypatch, [replaced])
    assert done.ok().stdout.startswith("sent 10 stops on ")
    assert count == 10
    assert "warning: " in done.stderr
    assert field in done.stderr


def test_stop_refuses_an_actuator_or_a_setting_that_is_wrong(lab, tmp_path, monkeypatch):
    """What is wrong may be the port, and stops on another one would stop no robot."""
    emulated = lab()
    done, count = stops_by_spec(emulated, tmp_path, monkeypatch, [("port: ", "prt: ")])
    assert (done.returncode, count) == (2, 0)
    assert "lab.actuator.prt" in done.stderr
    done, count = stops_by_spec(emulated, tmp_path, monkeypatch, [], "lab.actuator.robots.pink=1")
    assert (done.returncode, count) == (2, 0)
    assert "has no entry 'pink'" in done.stderr


@pytest.mark.long
def test_robots_move_only_where_that_is_asked_for(lab, tmp_path):
    """Regression: `rerun LABLOG </dev/null` set robots moving, as did `run --plant lab`."""
    emulated = lab(replace_after=6.0)
    sets = flags((*emulated.settings, "controller.time_limit=0.6", "lab.limits.placing=30"))

    def run(*words):
        done = tetractl(tmp_path, *words)
        assert len(emulated.events("run")) == started
        return done

    started = 0
    refused = run("run", SPEC, "--plant", "lab", "--out", "first", *sets)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "error: robots would move" in refused.stderr
    assert not (tmp_path / "first").exists()
    started = 1
    assert run("run", SPEC, "--plant", "lab", "--yes", "--out", "first", *sets).returncode == 0

    log = ("rerun", "first/trial-000.mcap", "--out")
    again = run(*log, "simulated").ok()
    assert "the log comes from the lab, but the new log comes from a simulation" in again.stderr
    assert read_trial(tmp_path / "simulated" / "trial-000.mcap").start.plant.simulated
    refused = run(*log, "lab", "--plant", "lab")
    assert (refused.returncode, refused.stdout) == (2, "")
    started = 2
    again = run(*log, "lab", "--plant", "lab", "--yes").ok()
    assert "both logs come from the lab, so they are not compared" in again.stderr


@pytest.mark.long
def test_calibrate_finds_what_the_robot_truly_is_and_the_log_attaches_it(lab, tmp_path):
    settings = lab(UNEVEN, replace_after=6).settings
    tetractl(
        tmp_path, "lab", "calibrate", str(SPEC), "--robot", "green", "--yes", *flags(settings)
    ).ok()
    text = (tmp_path / "calibration.yaml").read_text()
    lab = apply_calibration(
        select_plant(load_spec(SPEC), "lab").experiment, text, "calibration.yaml"
    ).plant
    green = entry(lab.actuator.robots, "green")
    assert green.swap
    assert green.left.invert is True
    assert green.right.invert is False
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
            "controller.time_limit=0.8",
        )
    )
    tetractl(tmp_path, "run", str(SPEC), "--plant", "lab", "--yes", "--out", "logs", *sets).ok()
    trial = read_trial(tmp_path / "logs" / "trial-000.mcap")
    assert trial.experiment.plant.actuator.robots[0].radius_mm == green.radius_mm
    assert attachment(tmp_path / "logs" / "trial-000.mcap", "calibration.yaml") == text


TWIST = "{type: twist, port: p, robots: [{name: green}, {name: blue}, {name: red}]}"
ODD = "{actuator: {robots: [{name: green, left_gain: 0.9, right_gain: 1.1}]}}"


@pytest.mark.long
def test_calibrate_drives_robots_that_take_lines_too(tmp_path):
    sets = (f"lab.actuator={TWIST}", f"plant.faults={{about: odd gains, emulation: {ODD}}}")
    words = ("lab", "calibrate", SPEC, "--plant", "emulated", "--robot", "green")
    tetractl(tmp_path, *words, *flags((*SMALL, *sets))).ok()
    text = (tmp_path / "calibration.yaml").read_text()
    spec = load_spec(SPEC, sets[:1])
    green, *_ = apply_calibration(
        select_plant(spec, "lab").experiment, text, "c.yaml"
    ).plant.actuator.robots
    radius = spec.experiment.setup.wheel_radius * spec.experiment.setup.metres * 1000
    assert green.left_gain == pytest.approx(0.9, rel=0.02)
    assert green.right_gain == pytest.approx(1.1, rel=0.02)
    assert green.radius_mm == pytest.approx(radius, rel=0.02)


def attachment(path, name):
    from mcap.reader import make_reader

    with path.open("rb") as file:
        attachments = make_reader(file).iter_attachments()
        (only_one,) = [attached for attached in attachments if attached.name == name]
        return only_one.data.decode()


def test_check_asks_about_a_radio_that_it_does_not_know(lab, tmp_path):
    emulated = lab("about: an odd radio\nemulation: {actuator: {hardware: 0x7F44}}")
    command = ("lab", "check", str(SPEC), *flags(emulated.settings))
    done = tetractl(tmp_path, *command)
    assert done.returncode == 1
    says = "the module (HV 7F44, VR 10EC) is not in tetractl's list: does it run"
    assert says in done.stdout
    assert (
        "there is no terminal in which to answer the questions; "
        "to answer yes to all of them, add --yes" in done.stderr
    )
    done = tetractl(tmp_path, *command, "--yes").ok()
    assert f"warning: {tmp_path / 'radio'}: the module" in done.stdout


def test_check_prints_the_names_that_the_cameras_have_beside_the_one_wanted(lab, tmp_path):
    settings = lab().settings
    sets = flags((*settings, "lab.camera.robots.green.body=Gren"))
    done = tetractl(tmp_path, "lab", "check", str(SPEC), *sets)
    assert done.returncode == 1
    assert (
        "problem: the camera server has no rigid body 'Gren' for green; did you mean 'green'?; "
        "it has 'green' (id 1); 'blue' (id 2); 'red' (id 3)"
    ) in done.stdout


def test_stop_needs_no_calibration(lab, tmp_path, monkeypatch):
    """Regression: not one stop was sent if the file was missing."""
    replaced = ("  # calibration: m3pi", "  calibration: m3pi")
    done, count = stops_by_spec(lab(), tmp_path, monkeypatch, [replaced])
    assert (done.returncode, count, done.stderr) == (0, 10, "")


def test_stop_takes_the_settings_of_a_run(lab, tmp_path, monkeypatch):
    """Regression: `--set plant.actuator.port=..`, as of `run --plant lab`, was refused."""
    emulated = lab()
    port = f"plant.actuator.port={tmp_path / 'radio'}"
    replaced = (str(tmp_path / "radio"), "/dev/ttyUSB0")
    done, count = stops_by_spec(emulated, tmp_path, monkeypatch, [replaced], port)
    assert (done.returncode, count, done.stderr) == (0, 10, "")


def test_a_port_that_is_missing_is_named_before_anything_is_compiled(tmp_path, monkeypatch):
    def compiled(*_):
        raise AssertionError("compiled")

    monkeypatch.setattr("tetractl.control.methods.build.warm_up", compiled)
    done = tetractl(
        tmp_path, "run", str(SPEC), "--plant", "lab", "--yes", "--set", "lab.actuator.port=nowhere"
    )
    assert done.returncode == 1
    assert done.stderr.endswith("nowhere: there is no such port\nhint: is the radio plugged in?\n")


def test_a_person_at_a_terminal_is_asked_before_robots_are_calibrated(lab, tmp_path, monkeypatch):
    """Regression: the question was on stdout, so that with `> values.txt` it was not seen."""
    monkeypatch.setattr("tetractl.cli.ui.require_yes_or_terminal", lambda yes: None)  # as at one
    emulated = lab()
    words = ("lab", "calibrate", SPEC, *flags(emulated.settings))
    done = tetractl(tmp_path, *words, stdin="n\n")
    assert done.returncode != 0
    assert "green, blue, red will move by up to 0.3 m each. Continue?" in done.stderr
    assert done.stdout.strip() == ""
    assert emulated.events("run") == []
