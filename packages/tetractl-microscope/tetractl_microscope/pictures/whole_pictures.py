"""The pictures of a run that its log has, as JPEG: one a second, and the background at times."""

from dataclasses import dataclass

import cv2
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.timestamp_pb2 import Timestamp

from tetractl.core.clock import SECOND
from tetractl.core.poses import Grey
from tetractl.log.format.channels import BACKGROUND, PICTURE

LENS = "microscope"  # name of the pictures' coordinate frame
WHOLE_NS = SECOND  # interval between whole pictures
BACKGROUND_NS = 10 * SECOND  # interval between backgrounds


def jpeg_image(picture: Grey, time: Timestamp | None = None) -> CompressedImage:
    """Encode a whole picture; `time` is that of its exposure, by default that of its message."""
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
    coded = data.tobytes() if done else b""
    return CompressedImage(timestamp=time, frame_id=LENS, data=coded, format="jpeg")


@dataclass(slots=True)
class PictureLog:
    """Makes the messages of whole pictures of one run."""

    _whole_ns: int = -WHOLE_NS
    _background_ns: int = -BACKGROUND_NS

    def messages(
        self, picture: Grey, exposed_ns: int, background: Grey | None
    ) -> tuple[tuple[str, bytes], ...]:
        """Return topic and bytes of the messages of a picture, if any is due."""
        messages: list[tuple[str, bytes]] = []
        if exposed_ns - self._whole_ns >= WHOLE_NS:
            self._whole_ns = exposed_ns
            messages.append((PICTURE, jpeg_image(picture).SerializeToString()))
        if background is not None and exposed_ns - self._background_ns >= BACKGROUND_NS:
            self._background_ns = exposed_ns
            messages.append((BACKGROUND, jpeg_image(background).SerializeToString()))
        return tuple(messages)
