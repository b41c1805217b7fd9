"""Tests that the examples of docs/apriltag.md work, and that its table lists every setting."""

import re

import pytest
import yaml
from testkit.microscope.needs_opencv import cv2
from testkit.paths import MICROSCOPE
from tetractl_microscope.apriltag.detect import Detector
from tetractl_microscope.apriltag.section import AprilTagSection

pytestmark = pytest.mark.slow

PAGE = (MICROSCOPE / "docs/apriltag.md").read_text()


def block(language):
    return re.search(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)[1]


def test_the_spec_is_read():
    section = AprilTagSection.model_validate(yaml.safe_load(block("yaml"))["lab"]["camera"])
    assert [robot.name for robot in section.robots] == ["green", "blue", "red"]


def test_the_printed_tags_are_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(block("python"), {})
    for path in tmp_path.glob("*.png"):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        (sighting,) = Detector().find(picture)
        assert path.name == f"tag-{sighting.tag}.png"
        assert sighting.side_px == pytest.approx(0.8 * picture.shape[0], abs=1)


def test_every_setting_is_in_the_table():
    table = "\n".join(line for line in PAGE.splitlines() if line.startswith("|"))
    for name in AprilTagSection.model_fields:
        assert name == "type" or f"| `{name}` |" in table
