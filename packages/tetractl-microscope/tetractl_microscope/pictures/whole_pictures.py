"""Adds whole images to the log of a run as JPEG: one per second, and sometimes the background."""

import cv2
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from tetractl.core.clock import SECOND
from tetractl.core.poses import GreyImage
from tetractl.log.format.channels import BACKGROUND_TOPIC, PICTURE_TOPIC

LENS = "microscope"  # name of the pictures' coordinate frame
WHOLE_NS = SECOND  # interval between whole pictures
BACKGROUND_NS = 10 * SECOND  # interval between backgrounds


def _encode_jpeg(picture: GreyImage) -> bytes:
    """Encode an image as JPEG in a log message. Its data is empty if encoding fails."""
    is_encoded, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
    coded = data.tobytes() if is_encoded else b""
    return CompressedImage(frame_id=LENS, data=coded, format="jpeg").SerializeToString()


class PictureLog:
    """Creates the log messages that contain whole images of a run."""

    def __init__(self) -> None:
        self._whole_ns = -WHOLE_NS
        self._background_ns = -BACKGROUND_NS

    def messages(
        self, picture: GreyImage, exposed_ns: int, background: GreyImage | None
    ) -> tuple[tuple[str, bytes], ...]:
        """Create the log messages that are due for an image.

        Args:
            picture: The image.
            exposed_ns: When it was exposed [ns].
            background: The background. None if there is none.

        Returns:
            Topic and bytes of each message. Empty if none is due.
        """
        messages: list[tuple[str, bytes]] = []
        if exposed_ns - self._whole_ns >= WHOLE_NS:
            self._whole_ns = exposed_ns
            messages.append((PICTURE_TOPIC, _encode_jpeg(picture)))
        if background is not None and exposed_ns - self._background_ns >= BACKGROUND_NS:
            self._background_ns = exposed_ns
            messages.append((BACKGROUND_TOPIC, _encode_jpeg(background)))
        return tuple(messages)
