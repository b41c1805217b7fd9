"""Tests of images from Micro-Manager, with a fake that follows the documentation of pymmcore."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from testkit.paths import EXAMPLES

pytest.importorskip("cv2")

from tetractl_microscope.pictures.feed import SourceEndedError
from tetractl_microscope.pictures.picture_section import MicroManagerSource

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.spec.load import load_spec
from tetractl.spec.yaml.problems import InvalidSpecError

pytestmark = pytest.mark.slow

CONFIG = "# a microscope\nDevice,Camera,DemoCamera,DCam\nProperty,Core,Camera,Camera\n"
DEEP = np.array([[0, 0x0FFF, 0x0800]], np.uint16)
COLOUR = np.array([[0x00102030]], np.uint32)  # a byte each: blue, green, red, none


class Core:
    """What is used of CMMCore; `waiting` are the pictures in its buffer."""

    fails = None
    depth = 12
    waiting = ()

    def __init__(self):
        self.done = []
        self.not_read = list(self.waiting)

    def setDeviceAdapterSearchPaths(self, folders):  # noqa: N802
        self.folders = folders

    def loadSystemConfiguration(self, config):  # noqa: N802
        assert list(Path().iterdir()) == []
        assert Path(config).is_file()
        if self.fails:
            raise self.fails

    def getImageBitDepth(self):  # noqa: N802
        return self.depth

    def startContinuousSequenceAcquisition(self, interval):  # noqa: N802
        assert interval == 0.0

    def getRemainingImageCount(self):  # noqa: N802
        return len(self.not_read)

    def popNextImage(self):  # noqa: N802
        return self.not_read.pop(0)

    def isSequenceRunning(self):  # noqa: N802
        return True

    def stopSequenceAcquisition(self):  # noqa: N802
        self.done.append("stopped")

    def reset(self):
        self.done.append("reset")


@pytest.fixture
def feed(monkeypatch, tmp_path):
    """A function that opens the source; Micro-Manager is installed in `tmp_path`/installed."""
    installed = tmp_path / "installed"
    installed.mkdir()
    (installed / "libmmgr_dal_DemoCamera.so.0").touch()
    monkeypatch.setenv("MICROMANAGER_PATH", str(installed))

    def opened(text=CONFIG, **facts):
        wire_class = type("Core", (Core,), facts)
        monkeypatch.setitem(sys.modules, "pymmcore", SimpleNamespace(CMMCore=wire_class))
        (tmp_path / "scope.cfg").write_text(text)
        source = MicroManagerSource(type="micromanager", config=str(tmp_path / "scope.cfg"))
        return source.open(VirtualClock(), 1.0)

    return opened


@pytest.mark.parametrize(
    ("depth", "pixels", "grey"), [(12, DEEP, [[0, 255, 128]]), (8, COLOUR, [[0x20]])]
)
def test_pictures_come_one_by_one_as_eight_bits_and_a_silent_camera_ends(depth, pixels, grey, feed):
    opened = feed(depth=depth, waiting=(pixels, pixels))
    assert opened.live
    assert [opened.read().content.tolist() for _ in range(2)] == [grey, grey]
    with pytest.raises(SourceEndedError, match="sends no more"):
        opened.read()
    assert opened._clock.now() > 9 * SECOND
    opened.interrupt()
    with pytest.raises(SourceEndedError, match="closed"):
        opened.read()
    opened.close()
    assert opened._core.done == ["stopped", "reset"]


def test_what_keeps_it_from_opening_is_one_line(feed, monkeypatch):
    for error in (RuntimeError, OSError, ValueError):  # all three come from the real core
        with pytest.raises(AbortError, match=r"(?m)scope.cfg: Line 1: no such camera$"):
            feed(fails=error("Line 1:\nno such camera\n\n"))
    opened = sys.modules["pymmcore"]
    monkeypatch.setitem(sys.modules, "pymmcore", None)
    with pytest.raises(AbortError, match="pymmcore") as caught:
        MicroManagerSource(type="micromanager", config="scope.cfg").open(VirtualClock(), 1.0)
    assert "tetractl-microscope[micro-manager]" in caught.value.hint
    monkeypatch.setitem(sys.modules, "pymmcore", opened)
    monkeypatch.delenv("MICROMANAGER_PATH")
    with pytest.raises(AbortError, match="not installed") as caught:
        feed()
    assert "MICROMANAGER_PATH=" in caught.value.hint


LIBRARIES = ("Planted", "../Planted", "x/Planted", "DemoCamera.so", " DemoCamera", "Demo\0Camera")
HOSTILE = (
    *(f"Device,Evil,{library},E" for library in LIBRARIES),
    "Device,,DemoCamera,x/Planted,Dev",
    ",Device,DemoCamera,x/Planted,Dev",
    "Device,Evil,,,x\\\\Planted,,E,",
    "Device,Evil,Planted,E\r,DemoCamera",
    "Device,\u2028Evil,Planted,E",
    "Device,x/Planted,DemoCamera,E",
    "Property,Hub,Script,x/planted.py",
    "Property,Hub,,Script,..",
    "ConfigGroup,System,Startup,Hub,Script,./planted.py",
    "Load,x/Planted",
)


@pytest.mark.parametrize("line", HOSTILE)
def test_only_libraries_of_the_installed_folder_are_run(line, feed, tmp_path, monkeypatch):
    """Regression: those in the folder of the configuration were, and those of a line that the core
    splits otherwise: it leaves out empty fields."""
    monkeypatch.chdir(tmp_path)
    for place in (tmp_path, tmp_path / "libmmgr_dal_x"):
        place.mkdir(exist_ok=True)
        (place / "libmmgr_dal_Planted.so.0").touch()
    with pytest.raises(AbortError, match=r"scope.cfg:2: .* device adapter"):
        feed(f"Device,Camera,DemoCamera,DCam\n{line}\n")
    assert feed()._core.folders == [str(tmp_path / "installed")]
    assert Path.cwd() == tmp_path


def test_no_spec_names_the_folder_of_the_libraries():
    camera = "{type: cells, um_px: 2, source: {type: micromanager, config: a, adapters: [/tmp]}}"
    with pytest.raises(InvalidSpecError, match="adapters: unknown key"):
        load_spec(EXAMPLES / "tetrahymena_dish.yaml", [f"lab.camera={camera}"])
