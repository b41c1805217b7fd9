"""Tests of sources of images: files, devices, and answers of a network camera."""

import struct
import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL.JpegImagePlugin import JpegImageFile
from pydantic import TypeAdapter, ValidationError
from testkit.microscope.needs_opencv import cv2
from testkit.microscope.tag_scene import film, jpeg
from tetractl_microscope.pictures.feed import Picture, SourceEndedError
from tetractl_microscope.pictures.picture_section import (
    DeviceSource,
    FileSource,
    MjpegSource,
    PictureSection,
    PictureSource,
)
from tetractl_microscope.pictures.source import decode_to_grey
from tetractl_microscope.registries import PICTURE_SOURCES

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import AbortError

pytestmark = pytest.mark.slow

PICTURE = np.tile(np.arange(0, 240, 2, dtype=np.uint8), (90, 1))


def test_a_film_plays_at_its_own_rate(tmp_path):
    source = FileSource(**film(tmp_path / "film.avi", [PICTURE] * 5, rate=20.0))
    clock = VirtualClock()
    clock.sleep_until(3 * SECOND)
    feed = source.open(clock, 1.0)
    assert feed.rate_hz == pytest.approx(20.0)
    assert feed.emulated  # a film shows no robot that could be steered
    times = [feed.read().received_ns for _ in range(5)]
    assert times == [3 * SECOND + i * SECOND // 20 for i in range(5)]
    with pytest.raises(SourceEndedError, match="has ended"):
        feed.read()
    feed.close()


# imageio leaves a file open that none of its plugins can read
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_no_file_and_no_film_are_told_apart(tmp_path):
    no_file = FileSource(type="file", path=str(tmp_path / "no.avi"))
    with pytest.raises(AbortError, match="there is no file"):
        no_file.open(VirtualClock(), 1.0)
    text = tmp_path / "text.avi"
    text.write_text("no film")
    no_film = FileSource(type="file", path=str(text))
    with pytest.raises(AbortError, match="not a video that imageio can read"):
        no_film.open(VirtualClock(), 1.0)


def test_a_stack_of_16_bits_is_read_at_the_rate_of_the_spec(tmp_path):
    """A microscope's TIFF does not state its frame rate, and its camera uses 12 of 16 bits."""
    tifffile = pytest.importorskip("tifffile", reason="imageio[tifffile] is not installed")
    path = tmp_path / "stack.tif"
    deep = PICTURE.astype(np.uint16) * 16
    tifffile.imwrite(path, np.array([deep, deep // 2, deep]), photometric="minisblack")
    with pytest.raises(AbortError, match="does not state its frame rate") as error:
        FileSource(type="file", path=str(path)).open(VirtualClock(), 1.0)
    assert "lab.camera.source.rate" in error.value.hint
    feed = FileSource(type="file", path=str(path), rate=7.0).open(VirtualClock(), 1.0)
    assert feed.rate_hz == 7.0
    assert [feed.read().content[0, 60] for _ in range(3)] == [120, 60, 120]
    with pytest.raises(SourceEndedError, match="has ended"):
        feed.read()


def test_without_imageio_a_film_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "film.avi").write_bytes(b"film")
    monkeypatch.setitem(sys.modules, "imageio.v3", None)
    with pytest.raises(AbortError, match="needs imageio") as error:
        FileSource(type="file", path=str(tmp_path / "film.avi")).open(VirtualClock(), 1.0)
    assert "[films]" in error.value.hint


class Capture:
    """Stands in for cv2.VideoCapture: a camera of one size that delivers three pictures."""

    opened = True
    size = (640, 480)
    not_read = 3

    def __init__(self, index, system):
        self.settings = {}
        self.released = False
        Capture.last = self

    def isOpened(self):  # noqa: N802
        return self.opened

    def set(self, what, value):
        self.settings[what] = value
        return True

    def get(self, what):
        if what in (cv2.CAP_PROP_EXPOSURE, cv2.CAP_PROP_GAIN):
            return min(self.settings[what], 100)
        return self.size[0] if what == cv2.CAP_PROP_FRAME_WIDTH else self.size[1]

    def grab(self):
        self.not_read -= 1
        return self.not_read >= 0

    def retrieve(self):
        return True, np.full((480, 640, 3), 7, np.uint8)

    def release(self):
        self.released = True


DEVICE = DeviceSource(type="device", index=2, width=640, height=480, rate=30)


def test_a_device_is_set_up_read_and_released(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    feed = DEVICE.open(VirtualClock(), 1.0)
    assert Capture.last.settings[cv2.CAP_PROP_FPS] == 30
    assert not feed.emulated
    assert Capture.last.settings[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"MJPG")
    for _ in range(3):
        picture = decode_to_grey(feed.read())
        assert (picture == 7).all()
    with pytest.raises(SourceEndedError, match="camera 2 sends no more"):
        feed.read()
    feed.close()
    assert Capture.last.released


@pytest.mark.parametrize(
    ("attribute", "value", "line"),
    [
        ("opened", False, "camera 2 cannot be opened"),
        ("size", (320, 240), "gives images of 320x240, not 640x"),
    ],
)
def test_a_device_that_cannot_be_used_says_so(monkeypatch, attribute, value, line):
    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    monkeypatch.setattr(Capture, attribute, value)
    with pytest.raises(AbortError, match=line):
        DEVICE.open(VirtualClock(), 1.0)


def answering(status, kind, body=b""):
    """A server on loopback that gives one answer."""

    class Answer(BaseHTTPRequestHandler):
        """Answers each request alike, and logs nothing."""

        def do_GET(self):
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *args):
            pass

    server = HTTPServer(("127.0.0.1", 0), Answer)
    threading.Thread(target=server.handle_request, daemon=True).start()
    return server, MjpegSource(type="mjpeg", url=f"http://127.0.0.1:{server.server_port}/video")


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (404, "text/html"),
        (200, "image/jpeg"),
        (200, "multipart/x-mixed-replace"),
        (503, "multipart/x-mixed-replace; boundary=b"),
    ],
)
def test_an_answer_that_is_no_stream_is_told(status, kind):
    server, source = answering(status, kind)
    with pytest.raises(
        AbortError, match=f"does not send an MJPEG stream: it answers with status {status}"
    ):
        source.open(VirtualClock(), 5.0)
    server.server_close()


def test_a_stream_is_read_to_its_end():
    part = b"--b\r\nContent-Type: image/jpeg\r\n\r\n" + jpeg(PICTURE) + b"\r\n"
    server, source = answering(200, 'multipart/x-mixed-replace; boundary="b"', 3 * part + b"--b--")
    feed = source.open(VirtualClock(), 5.0)
    assert not feed.emulated  # though it is on loopback
    for _ in range(3):
        picture = decode_to_grey(feed.read())
        assert picture.shape == PICTURE.shape
    with pytest.raises(SourceEndedError, match="closed the stream"):
        feed.read()
    feed.close()
    server.server_close()


@given(st.integers(0, 10_000), st.binary(max_size=20))
def test_a_jpeg_cut_short_is_none_and_a_spoiled_one_does_no_harm(cut, spoil):
    whole_jpeg = jpeg(PICTURE)
    cut %= len(whole_jpeg)
    assert decode_to_grey(Picture(whole_jpeg[:cut], 0)) is None
    spoiled = whole_jpeg[:cut] + spoil + whole_jpeg[cut + len(spoil) :]
    grey = decode_to_grey(Picture(spoiled, 0))
    assert grey is None or grey.dtype == np.uint8


def claiming(width, height, content):
    """A JPEG whose header claims another size than its data have."""
    place = content.index(b"\xff\xc0") + 5
    return content[:place] + struct.pack(">HH", height, width) + content[place + 4 :]


@pytest.mark.parametrize("size", [None, PICTURE.shape])
def test_a_jpeg_that_claims_to_be_huge_is_not_decoded(size, monkeypatch):
    """Regression: 335 bytes took 2 GB and 12 s."""
    monkeypatch.setattr(JpegImageFile, "load", lambda self: pytest.fail("it is decoded"))
    bomb = claiming(32767, 32767, jpeg(np.zeros((8, 8), np.uint8)))
    assert len(bomb) < 400
    assert decode_to_grey(Picture(bomb, 0), size) is None


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("restarts", [0, 4])
def test_a_jpeg_cut_short_before_an_end_marker_is_damaged(colour, restarts):
    """Regression: it was decoded into a picture that is partly grey."""
    pixels = np.dstack([PICTURE, PICTURE[::-1], PICTURE]) if colour else PICTURE
    whole_jpeg = jpeg(pixels, restarts=restarts)
    grey = decode_to_grey(Picture(whole_jpeg, 0))
    assert np.array_equal(grey, cv2grey(whole_jpeg))
    start = whole_jpeg.index(b"\xff\xda") + 10
    for cut in range(start, len(whole_jpeg) - 24):
        assert decode_to_grey(Picture(whole_jpeg[:cut] + b"\xff\xd9", 0)) is None


def cv2grey(content):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)


def test_exposure_and_gain_of_a_device_are_set_or_refused(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    DEVICE.model_copy(update={"exposure": 80.0, "gain": 5.0}).open(VirtualClock(), 1.0)
    settings_used = Capture.last.settings
    assert (settings_used[cv2.CAP_PROP_EXPOSURE], settings_used[cv2.CAP_PROP_GAIN]) == (80.0, 5.0)
    assert settings_used[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    with pytest.raises(AbortError, match="camera 2 does not accept exposure 200, and keeps 100"):
        DEVICE.model_copy(update={"exposure": 200.0}).open(VirtualClock(), 1.0)
    assert Capture.last.released


def test_a_source_of_another_package_is_found_by_its_name(monkeypatch):
    monkeypatch.setitem(PICTURE_SOURCES.builtin, "still", "testkit.microscope.still_source:Still")
    mark = next(m for m in PictureSection.model_fields["source"].metadata)
    source = TypeAdapter(Annotated[PictureSource, mark]).validate_python(
        {"type": "still", "grey": 9}
    )
    feed = source.open(VirtualClock(), 1.0)
    assert (decode_to_grey(feed.read()) == 9).all()
    assert source.shown == "still"
    source.checked()
    with pytest.raises(ValidationError, match="unknown type"):
        TypeAdapter(Annotated[PictureSource, mark]).validate_python({"type": "stil"})


def test_a_camera_that_is_not_there_is_said_once(capfd):
    """Regression: OpenCV wrote two lines of warnings above ours."""
    with pytest.raises(AbortError, match="camera 63 cannot be opened"):
        DeviceSource(type="device", index=63, width=64, height=64, rate=30).open(
            VirtualClock(), 1.0
        )
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("field", "accepted", "refused"),
    [
        ("index", (0, 1, 63), (-1, 64)),
        ("gain", (None, 0, 0.5, 255), (-0.1,)),
        ("exposure", (None, 0.1, 5000), (0, -1)),
        ("rate", (0.1, 30, 1000), (0, -5)),
    ],
)
def test_settings_of_a_device_are_taken_up_to_their_bounds(field, accepted, refused):
    """A gain of 0 is what most cameras have as their least."""
    for value in accepted:
        assert getattr(DeviceSource(**{"type": "device", field: value}), field) == value
    for value in refused:
        with pytest.raises(ValidationError, match=field):
            DeviceSource(**{"type": "device", field: value})


@pytest.mark.parametrize(
    ("field", "accepted", "refused"), [("latency", (0, 0.5), (-0.1,)), ("connect", (0.1,), (0, -1))]
)
def test_times_of_a_section_are_taken_up_to_their_bounds(field, accepted, refused):
    check = TypeAdapter(Annotated[float, PictureSection.model_fields[field]])
    for value in accepted:
        assert check.validate_python(value) == value
    for value in refused:
        with pytest.raises(ValidationError):
            check.validate_python(value)
