"""Tests of the commands of a lab: which robots are stopped, checks, and written calibrations."""

from types import SimpleNamespace

import pytest
import yaml
from testkit.paths import ROOT

from tetractl.cli import lab as module
from tetractl.cli.lab import (
    _find_stop_function,
    _load_for_plant,
    calibrate,
    check,
    save_calibration,
    stop,
)
from tetractl.core.errors import Exit, UsageError
from tetractl.lab.serial_port import PortHeldError
from tetractl.spec.lab_section import Measured
from tetractl.spec.yaml.problems import InvalidSpecError

LAB = ROOT / "experiments/three_m3pi_lab.yaml"


@pytest.mark.parametrize(("spec", "port"), [(None, None), (LAB, "/dev/ttyUSB0")])
def test_a_stop_needs_a_spec_or_a_port_and_not_both(spec, port):
    with pytest.raises(UsageError, match="give either a spec or --port"):
        _find_stop_function(spec, None, port, 57600)


def test_a_stop_by_port_is_for_the_radio_on_it():
    stops = _find_stop_function(None, None, "/dev/ttyUSB7", 9600)
    radio, _ = stops.args
    assert (radio.port, radio.baud) == ("/dev/ttyUSB7", 9600)
    with pytest.raises(UsageError, match=r"^--baud: "):
        _find_stop_function(None, None, "/dev/ttyUSB7", 0)


def names_stopped(stops):
    setup, _ = stops.args
    return setup.names


def test_a_stop_by_spec_is_for_the_robots_of_its_lab(capsys):
    stops = _find_stop_function(LAB, ["plant.actuator.port=/dev/other"], None, 57600)
    assert names_stopped(stops) == ("green", "blue", "red")
    assert stops.func.__self__.port == "/dev/other"
    assert capsys.readouterr().err == ""


def test_robots_are_stopped_although_another_part_of_the_spec_is_wrong(tmp_path, capsys):
    path = tmp_path / "s.yaml"
    path.write_text(LAB.read_text().replace("a: 6", "a: -6"))
    stops = _find_stop_function(path, None, None, 57600)
    assert names_stopped(stops) == ("green", "blue", "red")
    assert "must be greater than 0" in capsys.readouterr().err


def test_no_robot_is_stopped_by_a_wrong_setting_or_without_an_actuator(tmp_path):
    """The setting may have named the port."""
    with pytest.raises(InvalidSpecError):
        _find_stop_function(LAB, ["lab.actuator.port"], None, 57600)
    path = tmp_path / "s.yaml"
    path.write_text("name: s\n")
    with pytest.raises(InvalidSpecError):
        _find_stop_function(path, None, None, 57600)


@pytest.fixture
def held(monkeypatch):
    """Let the stop fail with these held ports before it succeeds; runs beside it are recorded."""
    asked = SimpleNamespace(ports=[], beside=[], alone=[])

    def stop_all(alone=True):
        asked.alone.append(alone)
        if asked.ports:
            raise PortHeldError(asked.ports.pop(0))
        return "stopped 3 robots"

    monkeypatch.setattr(module, "_find_stop_function", lambda *_: stop_all)
    monkeypatch.setattr(module, "stop_and_end_holder", lambda port, *_: asked.beside.append(port))
    return asked


def test_a_stop_says_what_was_sent(held, capsys):
    assert stop(LAB) == Exit.DONE
    assert capsys.readouterr().out == "stopped 3 robots\n"
    assert held.beside == []
    assert held.alone == [True]


def test_a_run_that_holds_the_port_is_ended_and_the_stop_repeated(held, capsys):
    held.ports = ["/dev/a", "/dev/b"]
    assert stop(LAB) == Exit.DONE
    assert held.beside == ["/dev/a", "/dev/b"]
    assert capsys.readouterr().out == "stopped 3 robots\n"


def test_a_port_that_is_held_again_is_an_error(held):
    held.ports = ["/dev/a", "/dev/a"]
    with pytest.raises(PortHeldError):
        stop(LAB)
    assert held.beside == ["/dev/a"]


# check


@pytest.fixture
def checked(monkeypatch):
    """Let a lab be checked with this result."""

    def run(can_start=True, questions=(), answers=(), terminal=True, yes=False):
        left = list(answers)
        preflight = SimpleNamespace(can_start=can_start, questions=list(questions))
        monkeypatch.setattr("tetractl.lab.preflight.inspect_lab", lambda rig, practice: preflight)
        monkeypatch.setattr(module.ui, "build_rig_of", lambda experiment: None)
        monkeypatch.setattr("tetractl.view.terminal.findings.print_findings", lambda *_: None)
        monkeypatch.setattr(module, "has_keys", lambda: terminal)
        monkeypatch.setattr(module.typer, "confirm", lambda question, err: left.pop(0))
        return check(LAB, yes=yes)

    return run


@pytest.mark.parametrize(
    ("case", "code"),
    [
        ({}, 0),
        ({"can_start": False}, 1),
        ({"can_start": False, "yes": True}, 1),
        ({"questions": ["a?"], "answers": [True]}, 0),
        ({"questions": ["a?", "b?"], "answers": [True, False]}, 1),
        ({"questions": ["a?"], "yes": True, "terminal": False}, 0),
        ({"questions": ["a?"], "terminal": False}, 1),
        ({"terminal": False}, 0),
    ],
)
def test_a_run_could_start_if_nothing_is_wrong_and_every_question_is_answered(checked, case, code):
    assert checked(**case) == Exit(code)


# calibrate


def test_only_robots_of_the_spec_are_calibrated(tmp_path):
    with pytest.raises(UsageError, match="--robot pink: the spec has no robot"):
        calibrate(LAB, out=tmp_path / "m.yaml", robot=["red", "pink"])
    (tmp_path / "m.yaml").touch()
    with pytest.raises(UsageError, match="exists already"):
        calibrate(LAB, out=tmp_path / "m.yaml")


@pytest.mark.parametrize("emulated", [(), ("camera", "actuator")])
def test_a_calibration_is_printed_and_written_for_a_spec(tmp_path, capsys, emulated):
    measured = Measured(
        lines=("red: 7 mm",), emulated=emulated, camera={"x": 1}, actuator={"robots": []}
    )
    out = tmp_path / "m.yaml"
    assert save_calibration(out, measured) == Exit.DONE
    written = yaml.safe_load(out.read_text())
    assert (written["camera"], written["actuator"]) == ({"x": 1}, {"robots": []})
    assert written.get("emulated") == (", ".join(emulated) or None)
    said = capsys.readouterr()
    assert said.out == "red: 7 mm\n"
    assert ("of an emulated camera and actuator" in said.err) == bool(emulated)


def test_a_spec_is_loaded_for_its_lab():
    loaded = _load_for_plant(LAB, ["plant.limits.stale=0.2"], "lab")
    assert loaded.experiment.plant.limits.stale == 0.2
    assert not loaded.experiment.plant.simulated
