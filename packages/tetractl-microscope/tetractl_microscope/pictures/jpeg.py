"""Whole pictures as messages for a log, for display."""

import cv2
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.timestamp_pb2 import Timestamp

from tetractl.core.poses import Grey

LENS = "microscope"
"""Name of the images' coordinate frame."""


def jpeg_image(picture: Grey, time: Timestamp | None = None) -> CompressedImage:
    """Encode a whole picture; `time` is that of its exposure, by default that of its message."""
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
    coded = data.tobytes() if done else b""
    return CompressedImage(timestamp=time, frame_id=LENS, data=coded, format="jpeg")
