"""Tests of the AprilTag camera's section of a spec. They need no OpenCV."""

import pytest
from pydantic import ValidationError
from tetractl_microscope.apriltag.section import AprilTagSection

pytestmark = pytest.mark.slow

ROBOT = {"name": "green", "tag": 1, "size_mm": 80, "height_mm": 90}
FLOOR = [
    {"tag": 100 + i, "at": place, "size_mm": 120}
    for i, place in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)])
]
GOOD = {
    "type": "apriltag",
    "source": {"type": "mjpeg", "url": "http://192.168.1.30:8080/stream?x=1"},
    "robots": [ROBOT],
    "floor": FLOOR,
}


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"source": {"type": "mjpeg", "url": "https://camera/"}}, "url"),
        ({"source": {"type": "mjpeg", "url": "http://user:word@camera/"}}, "url"),
        ({"source": {"type": "device", "index": -1}}, "index"),
        ({"source": {"type": "usb"}}, "source"),
        ({"robots": [{**ROBOT, "tag": 100}]}, "tag 100 is used twice"),
        ({"robots": [{**ROBOT, "tag": 587}]}, "tag"),
        ({"floor": FLOOR[:3]}, "floor"),
        ({"floor": [{**tag, "at": (i, i)} for i, tag in enumerate(FLOOR)]}, "on one line"),
        ({"lens": {"focal_px": 900, "distortion": [0.1, 0.2]}}, "coefficients"),
        ({"min_margin": 3}, "min_margin"),
    ],
)
def test_what_cannot_be_is_refused(change, where):
    with pytest.raises(ValidationError, match=where):
        AprilTagSection.model_validate({**GOOD, **change})
