"""Checks the film in a log: what was found is found again in the crops, by the same code.

The blob of each crop is searched again, and a robot's logged pose must be where its blob is.
Another OpenCV may find another last pixel: then crops and what is said of them are only compared
with each other, and a note says so.
"""

import time
import zlib
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError

from tetractl.core.cell_film import CellFilm
from tetractl.log.format import channels
from tetractl.log.format.channels import Entry
from tetractl.log.format.crop_images import LENS, decode_crops, encode_film
from tetractl.log.format.scene import stamp
from tetractl.log.format.tetractl_pb2 import CellCrops
from tetractl.log.read import limits
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.difference import Difference

SAME = 1e-9  # relative, of a blob's numbers on another machine
NEAR_UM = 25.0  # half a body: how far a followed cell may be from its blob


class FilmCheck:
    """The film of one log; `notes` is what could not be compared."""

    def __init__(self, raw: RawLog, log: TrialLog, same_host: bool) -> None:
        self._raw, self._log, self._tolerance = raw, log, 0.0 if same_host else SAME
        self._rows = {int(number): i for i, number in enumerate(log.frames)}
        self._pictures = {
            (topic, entry.publish_ns): entry
            for topic in (channels.PICTURE, channels.BACKGROUND)
            for entry in raw.by_topic[topic]
        }
        self._named = 0
        self.notes: list[str] = []

    def differences(self) -> Iterator[Difference]:
        """Yield the first thing of each kind of message that is not as it was found."""
        cells, crops = (self._raw.by_topic[topic] for topic in (channels.CELLS, channels.CROPS))
        pictures = sum(len(self._raw.by_topic[topic]) for topic in channels.FILM[2:])
        wanted = "opencv" in self._log.start.plant.facts  # earlier logs have no film
        if self._log.damage or not (wanted or cells or crops or pictures):
            return
        again, until = self._comparable(), time.perf_counter() + limits.seconds_limit()
        seen: list[int] = []
        for number, (one, image) in enumerate(zip_longest(cells, crops)):
            name = f"{channels.CELLS}[{number}]"
            if one is None or image is None:
                yield Difference(None, name, "cells and crops do not come in pairs")
                return
            if again and time.perf_counter() > until:
                again = False
                self.notes.append(f"film: from {name} on not searched again, it takes too long")
            try:
                seen.append(self._checked(one, image, again))
            except (DecodeError, ValueError) as error:
                yield Difference(None, name, str(error))
                return
        if seen != self._log.frames.tolist():
            yield Difference(None, channels.CELLS, "does not have each camera frame once, in order")
        if pictures != self._named:
            yield Difference(
                None, channels.PICTURE, "a picture is not of any camera frame, or twice"
            )

    def _comparable(self) -> bool:
        """Return whether the search can be repeated here; note why not."""
        try:
            import cv2
        except ImportError:
            self.notes.append("film: not comparable, OpenCV is missing here")
            return False
        there = self._log.start.plant.facts.get("opencv")
        if there != cv2.__version__:
            text = f"film: not comparable, found by OpenCV {there}, here is {cv2.__version__}"
            self.notes.append(text)
        return there == cv2.__version__

    def _checked(self, one: Entry, image: Entry, again: bool) -> int:
        """Return the frame of a picture; ValueError for what does not fit."""
        cells, crops = CellCrops.FromString(one.data), RawImage.FromString(image.data)
        row = self._rows.get(cells.frame)
        if row is None:
            raise ValueError(f"of frame {cells.frame}, which is not among the camera frames")
        log, begin = self._log, self._log.start.start_unix_ns
        times = int(log.received_ns[row]) + begin, int(log.mocap_ns[row]) + begin
        if one[1:3] != times or image[1:3] != times:
            raise ValueError("is not of the time of its frame")
        film = decode_crops(cells, crops, int(log.mocap_ns[row]))
        ours, shown, _ = encode_film(film, log.sample(row).observation, begin)
        ours.MergeFrom(CellCrops(picture_crc=cells.picture_crc))
        if ours.SerializeToString() != one.data or shown.SerializeToString() != image.data:
            raise ValueError("the crops or poses are not those that it states")
        self._check_pictures(list(cells.picture_crc), times)
        self._check_robots(film, row)
        if again:
            _search_again(film, self._tolerance)
        return cells.frame

    def _check_pictures(self, stated: list[int], times: tuple[int, int]) -> None:
        for topic in (channels.PICTURE, channels.BACKGROUND):
            entry = self._pictures.get((topic, times[1]))
            if entry is None:
                continue
            self._named += 1
            image = CompressedImage.FromString(entry.data)
            made = CompressedImage(
                timestamp=stamp(times[1]), frame_id=LENS, data=image.data, format="jpeg"
            )
            if made.SerializeToString() != entry.data or entry.log_ns != times[0]:
                raise ValueError(f"{topic} is not as tetractl writes it")
            if not stated or stated.pop(0) != zlib.crc32(image.data):
                raise ValueError(f"{topic} is not the picture that it states")
        if stated:
            raise ValueError("a picture that it states is missing")

    def _check_robots(self, film: CellFilm, row: int) -> None:
        """The logged pose of a robot is where its blob is, if that is not of several cells."""
        log = self._log
        camera: Any = getattr(log.experiment.plant, "camera", None)
        if len(film.sure) != log.valid.shape[1] or (film.robots >= len(film.sure)).any():
            raise ValueError("is not of as many robots as the trial")
        placed = getattr(camera, "placed", None)
        _, _, height = log.start.plant.facts.get("resolution", "").partition("x")
        if placed is None or not height.isdecimal():
            return
        um_px, metres = camera.um_px, log.start.setup.metres
        for robot, merged, (x, y, *_) in zip(film.robots, film.merged, film.blobs, strict=True):
            if robot < 0 or merged or not log.valid[row, robot]:
                continue
            at = placed((x + 0.5) * um_px, (int(height) - 0.5 - y) * um_px, metres)
            gap = np.hypot(*(log.mocap[row, robot, :2] - at)) * metres * 1e6
            if not gap <= NEAR_UM:
                name = log.start.setup.names[robot]
                raise ValueError(f"{name} is {gap:.1f} um from its picture")


def _search_again(film: CellFilm, tolerance: float) -> None:
    """Raise ValueError where another blob is found than stated."""
    from tetractl.lab.cameras.cells.crops import found_again  # needs OpenCV

    for i, (crop, corner, blob) in enumerate(
        zip(film.crops, film.corners.tolist(), film.blobs, strict=True)
    ):
        found = found_again(crop, corner, blob.tolist(), film.limits)
        if found is None or not np.allclose(found, blob, rtol=tolerance, atol=tolerance):
            raise ValueError(f"crop {i} shows another blob than stated")
