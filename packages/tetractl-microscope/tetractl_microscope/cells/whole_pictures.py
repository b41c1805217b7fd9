"""Selects the pictures of a run that its log has: one a second, and the background now and then."""

from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.poses import Grey
from tetractl.log.format.channels import BACKGROUND, PICTURE
from tetractl_microscope.pictures.jpeg import jpeg_image

WHOLE_NS = SECOND  # interval between whole pictures
BACKGROUND_NS = 10 * SECOND  # interval between backgrounds


@dataclass(slots=True)
class PictureLog:
    """Makes the messages of whole pictures of one run."""

    _whole_ns: int = -WHOLE_NS
    _background_ns: int = -BACKGROUND_NS

    def messages(
        self, picture: Grey, exposed_ns: int, background: Grey | None
    ) -> tuple[tuple[str, bytes], ...]:
        """Return topic and bytes of the messages of a picture, if any is due."""
        made: list[tuple[str, bytes]] = []
        if exposed_ns - self._whole_ns >= WHOLE_NS:
            self._whole_ns = exposed_ns
            made.append((PICTURE, jpeg_image(picture).SerializeToString()))
        if background is not None and exposed_ns - self._background_ns >= BACKGROUND_NS:
            self._background_ns = exposed_ns
            made.append((BACKGROUND, jpeg_image(background).SerializeToString()))
        return tuple(made)
