"""Tests of the spec that `init --lab` writes: it is valid, and each part is in its place."""

import pytest

from tetractl.cli.specs import build_template
from tetractl.core.errors import UsageError
from tetractl.core.registries import TEMPLATES
from tetractl.spec.lab_template import lab_template
from tetractl.spec.load import parse_spec
from tetractl.spec.yaml.document import parse_document

ROBOTS = """\
@NAME@
arena: {left: 0, bottom: 0, width: 1600, height: 900}
robots:
  - {name: green, start: [1, 1], target: [2, 2], a: 1, speed: 1}
  - {name: blue, start: [1, 5], target: [2, 5], a: 1, speed: 1}
lab:
@CAMERA@
  actuator: {type: x}
"""
CAMERA = """\
  camera:
    size: [@WIDTH@, @HEIGHT@]
    first: tag @I@
    robots:
      - {name: @ROBOT@, tag: @I@}
"""


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """A package that brings the robots `carts` and `own`, and the camera `eye`."""
    for name, text in {
        "robots/carts": ROBOTS,
        "robots/own": ROBOTS.replace("@CAMERA@\n", "  camera: {type: own}\n"),
        "cameras/eye": CAMERA,
    }.items():
        file = tmp_path / f"{name}.yaml"
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
    monkeypatch.setattr(TEMPLATES, "load_usable", lambda: {"a package": tmp_path})


def parsed(text):
    return parse_document(text.replace("@NAME@", "name: s"), "s").data


@pytest.mark.usefixtures("parts")
def test_the_cameras_part_takes_its_place_and_has_a_line_for_each_robot():
    lab = parsed(lab_template("carts", "eye"))["lab"]
    assert lab == {
        "camera": {
            "size": [1600, 900],
            "first": "tag 0",
            "robots": [{"name": "green", "tag": 0}, {"name": "blue", "tag": 1}],
        },
        "actuator": {"type": "x"},
    }


@pytest.mark.usefixtures("parts")
def test_the_default_camera_is_optitrack():
    assert parsed(lab_template("carts", None))["lab"]["camera"]["type"] == "optitrack"


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize("camera", [None, "own"])
def test_robots_that_measure_their_own_poses_need_no_camera(camera):
    assert parsed(lab_template("own", camera))["lab"]["camera"] == {"type": "own"}


@pytest.mark.usefixtures("parts")
def test_robots_that_measure_their_own_poses_take_no_other_camera():
    with pytest.raises(UsageError, match="robots of type own measure their own poses") as caught:
        lab_template("own", "eye")
    assert caught.value.hint == "leave --camera out"


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("robots", "camera", "message"),
    [
        ("cart", "eye", "--robots cart: unknown; did you mean 'carts'?"),
        ("carts", "eyes", "--camera eyes: unknown; did you mean 'eye'?"),
    ],
)
def test_an_unknown_part_is_refused_with_a_similar_one(robots, camera, message):
    with pytest.raises(UsageError) as caught:
        lab_template(robots, camera)
    assert caught.value.message == message
    known = caught.value.hint.partition(";")[0]
    assert ("carts" in known) == (robots == "cart")


def test_the_part_of_a_package_that_is_not_installed_names_the_package(monkeypatch):
    monkeypatch.setattr(TEMPLATES, "load_usable", dict)
    with pytest.raises(UsageError, match="toio needs tetractl-toio, which is not"):
        lab_template("toio", None)


@pytest.mark.parametrize("robots", ["m3pi-xbee", "twist"])
def test_what_init_writes_is_a_valid_lab(robots):
    spec = parse_spec(build_template("new", "new.yaml", True, "optitrack", robots), "new.yaml")
    names = [robot.name for robot in spec.experiment.robots]
    assert [robot.name for robot in spec.experiment.lab.camera.robots] == names
    assert spec.experiment.lab.actuator.type == robots
