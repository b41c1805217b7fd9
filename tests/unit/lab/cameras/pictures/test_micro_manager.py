"""The source by Micro-Manager, against a stand-in for pymmcore's CMMCore as it is documented."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("cv2")

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.lab.cameras.pictures.feed import SourceEndedError
from tetractl.lab.cameras.pictures.picture_section import MicroManagerSource
from tetractl.lab.cameras.pictures.source import open_feed

SOURCE = MicroManagerSource(type="micromanager", config="scope.cfg")
DEEP = np.array([[0, 0x0FFF, 0x0800]], np.uint16)
COLOUR = np.array([[0x00102030]], np.uint32)  # a byte each: blue, green, red, none


class Core:
    """What is used of CMMCore; `waiting` are the pictures in its buffer."""

    fails, depth, waiting = "", 12, ()

    def __init__(self):
        self.done, self.left = [], list(self.waiting)

    def setDeviceAdapterSearchPaths(self, folders):  # noqa: N802
        self.folders = folders

    def loadSystemConfiguration(self, config):  # noqa: N802
        if self.fails:
            raise RuntimeError(self.fails)

    def getImageBitDepth(self):  # noqa: N802
        return self.depth

    def startContinuousSequenceAcquisition(self, interval):  # noqa: N802
        assert interval == 0.0

    def getRemainingImageCount(self):  # noqa: N802
        return len(self.left)

    def popNextImage(self):  # noqa: N802
        return self.left.pop(0)

    def isSequenceRunning(self):  # noqa: N802
        return True

    def stopSequenceAcquisition(self):  # noqa: N802
        self.done.append("stopped")

    def reset(self):
        self.done.append("reset")


def feed(monkeypatch, **facts):
    made = type("Core", (Core,), facts)
    monkeypatch.setitem(sys.modules, "pymmcore", SimpleNamespace(CMMCore=made))
    return open_feed(SOURCE, VirtualClock(), 1.0)


@pytest.mark.parametrize(
    ("depth", "pixels", "grey"), [(12, DEEP, [[0, 255, 128]]), (8, COLOUR, [[0x20]])]
)
def test_pictures_come_one_by_one_as_eight_bits_and_a_silent_camera_ends(
    depth, pixels, grey, monkeypatch
):
    opened = feed(monkeypatch, depth=depth, waiting=(pixels, pixels))
    assert opened.live
    assert [opened.read().content.tolist() for _ in range(2)] == [grey, grey]
    with pytest.raises(SourceEndedError, match="delivers no more"):
        opened.read()
    assert opened._clock.now() > 9 * SECOND
    opened.interrupt()
    with pytest.raises(SourceEndedError, match="closed"):
        opened.read()
    opened.close()
    assert opened._core.done == ["stopped", "reset"]


def test_what_keeps_it_from_opening_is_one_line(monkeypatch):
    with pytest.raises(AbortError, match=r"scope.cfg: no such camera"):
        feed(monkeypatch, fails="no such camera")
    monkeypatch.setitem(sys.modules, "pymmcore", None)
    with pytest.raises(AbortError, match="pymmcore") as caught:
        open_feed(SOURCE, VirtualClock(), 1.0)
    assert "tetractl[microscope]" in caught.value.hint
