"""Tests of the list of kinds, with the problem of each, and of the check of a user's own kind."""

import json
from dataclasses import dataclass
from types import SimpleNamespace

import pytest
from testkit.paths import ROOT

from tetractl.cli import kinds as module
from tetractl.cli.kinds import _format_line, _load_kind, _parse_fields, _read_lab_fields, kinds
from tetractl.core.errors import Exit, UsageError
from tetractl.core.registry import Kind, PluginError
from tetractl.spec.load import load_spec


def registry_of(*listed, raises=None, what="camera", group="tetractl.cameras"):
    """A registry of these kinds; loading one raises the error that stands at its name."""
    errors = raises or {}

    def load(name):
        if name in errors:
            raise errors[name]
        return object

    return SimpleNamespace(
        what=what,
        group=group,
        load=load,
        kinds=lambda: listed,
        names=lambda: [kind.name for kind in listed],
    )


OURS = Kind("optitrack", "tetractl.lab:Section")
PACKAGED = Kind("cells", "tetractl_microscope.cells:Cells", "tetractl-microscope", "0.1")
FOREIGN = Kind("kinect", "kinect_camera:Section", "kinect-camera", "2.0")


def lacking(module_name):
    return ModuleNotFoundError(f"No module named '{module_name}'", name=module_name)


def plugin_error(cause=None):
    error = PluginError("the camera 'kinect' cannot be used: it fails")
    error.__cause__ = cause
    return error


def problem(kind, error):
    """What a kind lacks, and why it is broken."""
    row = _load_kind(registry_of(kind, raises={kind.name: error} if error else None), kind)
    return row.lacks, row.broken


def test_a_kind_that_loads_has_no_problem():
    assert problem(OURS, None) == problem(FOREIGN, None) == ("", "")


@pytest.mark.parametrize("kind", [OURS, PACKAGED])
def test_a_kind_of_ours_may_lack_another_module(kind):
    """Such as OpenCV; it is no error of the installation."""
    assert problem(kind, lacking("cv2")) == ("cv2", "")
    assert problem(kind, plugin_error(lacking("cv2.aruco"))) == ("cv2.aruco", "")


@pytest.mark.parametrize("kind", [OURS, PACKAGED])
def test_a_kind_that_lacks_a_module_of_its_own_package_is_broken(kind):
    own = kind.code.partition(".")[0]
    lacks, broken = problem(kind, lacking(f"{own}.gone"))
    assert lacks == ""
    assert "No module named" in broken


def test_a_kind_of_another_package_is_broken_whatever_it_lacks():
    lacks, broken = problem(FOREIGN, plugin_error(lacking("numpyy")))
    assert lacks == ""
    assert broken == "the camera 'kinect' cannot be used: it fails"
    assert problem(FOREIGN, plugin_error(ValueError("x")))[1] == broken
    assert problem(FOREIGN, plugin_error())[1] == broken


def test_an_error_without_a_module_is_no_lack():
    assert problem(PACKAGED, plugin_error(ValueError("x")))[0] == ""


# the list


def listed(monkeypatch, capsys, *registries, as_json=False):
    monkeypatch.setattr(module, "all_registries", lambda: registries)
    code = kinds(as_json=as_json)
    return code, capsys.readouterr()


def test_a_line_for_each_kind_and_for_each_that_a_package_would_bring(monkeypatch, capsys):
    registry = registry_of(OURS, PACKAGED)
    code, said = listed(monkeypatch, capsys, registry)
    assert code == Exit.DONE
    lines = said.out.splitlines()
    assert lines[0].split() == ["camera", "optitrack", "built", "in", "tetractl.lab:Section"]
    assert lines[1].split()[:4] == ["camera", "cells", "tetractl-microscope", "0.1"]
    missing = {line.split()[1]: line for line in lines[2:]}
    assert "cells" not in missing
    assert missing["toio"].split()[2:] == ["tetractl-toio", "[not", "installed]"]
    assert list(missing) == sorted(missing)
    assert said.err == ""


def test_a_broken_kind_is_an_error_and_one_that_lacks_a_module_is_not(monkeypatch, capsys):
    lacks = registry_of(PACKAGED, raises={"cells": lacking("cv2")})
    code, said = listed(monkeypatch, capsys, lacks)
    assert code == Exit.DONE
    assert said.out.splitlines()[0].endswith("  [needs cv2, which is not installed]")
    assert said.err == ""
    broken = registry_of(OURS, FOREIGN, raises={"kinect": plugin_error()})
    code, said = listed(monkeypatch, capsys, broken)
    assert code == Exit.USAGE
    assert said.err == "error: the camera 'kinect' cannot be used: it fails\n"
    assert "optitrack" in said.out


def test_json_holds_the_same(monkeypatch, capsys):
    registry = registry_of(OURS, FOREIGN, raises={"kinect": plugin_error()})
    code, said = listed(monkeypatch, capsys, registry, as_json=True)
    assert code == Exit.USAGE
    ours, foreign = json.loads(said.out)["kinds"]
    assert ours == {
        "seam": "camera",
        "type": "optitrack",
        "package": None,
        "version": None,
        "code": "tetractl.lab:Section",
        "problem": None,
    }
    assert (foreign["package"], foreign["version"]) == ("kinect-camera", "2.0")
    assert foreign["problem"] == "the camera 'kinect' cannot be used: it fails"


def test_a_built_in_kind_of_one_of_our_packages_names_this():
    kind = Kind("x", "tetractl_emulator.x:X")
    line = _format_line(_load_kind(registry_of(kind), kind))
    assert "built in tetractl-emulator" in line


# --check


@pytest.mark.parametrize("options", [{"sets": ["a=1"]}, {"spec": ROOT / "x.yaml"}])
def test_fields_and_a_spec_need_a_check(options):
    with pytest.raises(UsageError, match="only together with --check"):
        kinds(**options)


def test_fields_are_yaml():
    fields = _parse_fields(["radius=5", "center=[1, 2]", "name='5'", "text=a=b"])
    assert fields == {"radius": 5, "center": (1, 2), "name": "5", "text": "a=b"}


@pytest.mark.parametrize("setting", ["radius", "=5", ""])
def test_a_field_needs_a_name_and_a_value(setting):
    with pytest.raises(UsageError, match="write it as FIELD=VALUE"):
        _parse_fields([setting])


LAB = ROOT / "experiments/three_m3pi_lab.yaml"


def test_the_fields_of_a_lab_are_those_of_the_checked_device():
    experiment = load_spec(LAB).experiment
    camera, actuator = experiment.lab.camera, experiment.lab.actuator
    for section in (camera, actuator):
        code = f"{type(section).__module__}:{type(section).__qualname__}"
        assert _read_lab_fields(experiment, code) == dict(section)
    assert _read_lab_fields(experiment, "mine:Camera") == {}
    without = experiment.model_copy(update={"lab": None})
    assert _read_lab_fields(without, "mine:Camera") == {}


@dataclass
class Finding:
    what: str
    problem: str


class Checked:
    """Stands for the check of a kind; it keeps what it was asked."""

    def __init__(self, *problems):
        self.findings = [Finding(f"thing {i}", text) for i, text in enumerate(problems)]

    def __call__(self, code, fields, setup):
        self.asked = code, fields, setup
        return self.findings


@pytest.fixture
def path(monkeypatch):
    monkeypatch.setattr("sys.path", ["here"])


def check(monkeypatch, capsys, checked, **options):
    monkeypatch.setattr(module, "_load_kind_check", lambda: checked)
    code = kinds(check="mine:Kind", **options)
    return code, capsys.readouterr().out


@pytest.mark.usefixtures("path")
def test_each_finding_is_a_line_and_a_wrong_one_fails(monkeypatch, capsys):
    code, out = check(monkeypatch, capsys, Checked("", "is wrong"))
    assert code == Exit.FAILED
    assert out.splitlines() == [
        "ok     thing 0",
        "WRONG  thing 1: is wrong",
        "mine:Kind: 1 of 2 checks failed",
    ]
    code, out = check(monkeypatch, capsys, Checked("", ""))
    assert code == Exit.DONE
    assert out.splitlines()[-1] == "mine:Kind: 0 of 2 checks failed"


@pytest.mark.usefixtures("path")
def test_a_check_gets_the_fields_and_robots_of_a_spec(monkeypatch, capsys):
    checked = Checked("")
    check(monkeypatch, capsys, checked, sets=["radius=5"])
    code, fields, setup = checked.asked
    assert (code, fields) == ("mine:Kind", {"radius": 5})
    assert setup.names == ("green", "blue")  # those of `init`
    check(monkeypatch, capsys, checked, spec=LAB)
    code, fields, setup = checked.asked
    assert fields == {}
    assert setup.names == ("green", "blue", "red")


def test_a_set_field_replaces_that_of_the_spec(monkeypatch, capsys, path):
    camera = load_spec(LAB).experiment.lab.camera
    checked = Checked("")
    monkeypatch.setattr(module, "_load_kind_check", lambda: checked)
    code = f"{type(camera).__module__}:{type(camera).__qualname__}"
    kinds(check=code, spec=LAB, sets=["latency=0.5"])
    _, fields, _ = checked.asked
    assert fields["latency"] == 0.5
    assert fields["robots"] == camera.robots


@pytest.mark.usefixtures("path")
def test_findings_as_json(monkeypatch, capsys):
    code, out = check(monkeypatch, capsys, Checked("is wrong"), as_json=True)
    assert code == Exit.FAILED
    assert json.loads(out)["ok"] is False
    code, out = check(monkeypatch, capsys, Checked(""), as_json=True)
    assert (code, json.loads(out)["ok"]) == (Exit.DONE, True)


def test_a_check_needs_the_package_that_brings_it(monkeypatch):
    monkeypatch.setattr(module, "KIND_CHECKS", {})
    monkeypatch.setattr(
        module, "KIND_CHECKS", type("R", (dict,), {"group": "tetractl.kind_checks"})()
    )
    with pytest.raises(UsageError, match="needs tetractl-testing") as caught:
        kinds(check="mine:Kind")
    assert "pip install" in caught.value.hint
