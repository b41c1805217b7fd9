"""A source of images as a plug-in could provide it, which repeats the same image."""

from typing import ClassVar, Literal

import numpy as np
from tetractl_microscope.pictures.feed import Feed, Picture
from tetractl_microscope.pictures.picture_section import PictureSource


class Still(PictureSource):
    """A grey picture."""

    feed: ClassVar[str] = "testkit.microscope.still_source:StillFeed"
    type: Literal["still"]
    grey: int = 7


class StillFeed(Feed):
    """The open source."""

    rate_hz = 10.0

    def __init__(self, source, clock, timeout_s):
        self.source = source
        self.clock = clock

    def read(self):
        return Picture(np.full((64, 64), self.source.grey, np.uint8), self.clock.now())
