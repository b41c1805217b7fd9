"""Checks the film of cells in a log: searches the logged crops for the cells again, with the code
that found them first.

The search in each crop must find the logged blob, and a robot's logged position must be within
NEAR_UM [um] of its blob. With another version of OpenCV than the log's, blobs may differ by a
pixel: then the crops are not searched, and a note says so.
"""

import time
from collections.abc import Iterator

import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError

from tetractl.core.cell_film import CellFilm
from tetractl.log.format import channels
from tetractl.log.format.channels import Entry
from tetractl.log.format.crop_images import checksums, decode_crops
from tetractl.log.format.tetractl_pb2 import CellCrops
from tetractl.log.read import limits
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.difference import Difference

BLOB_TOLERANCE = 1e-9  # relative tolerance of a blob's numbers on another machine
NEAR_UM = 25.0  # largest distance of a followed cell from its blob: half a cell's length


def film_differences(
    raw: RawLog, log: TrialLog, same_host: bool, notes: list[str]
) -> Iterator[Difference]:
    """Yield the first difference between the logged cells and those found again, if any; add to
    `notes` which comparisons are not possible.
    """
    written_with = log.start.plant.facts.get("opencv")
    by_time = dict[tuple[int, int], list[Entry]]()
    for entry in (one for topic in channels.FILM for one in raw.by_topic[topic]):
        by_time.setdefault(entry[1:3], []).append(entry)
    if log.damage or not (written_with or by_time):
        return
    stamps = np.column_stack([log.received_ns, log.mocap_ns]) + log.start.start_unix_ns
    times = [(received, exposed) for received, exposed in stamps.tolist()]
    if sorted(by_time) != sorted(times):
        yield Difference(None, channels.CELLS, "does not have one message per camera frame")
        return
    if (here := _opencv()) != written_with:
        text = f"film: not comparable: written with OpenCV {written_with}, read with {here}"
        notes.append(text)
    again, until = here == written_with, time.thread_time() + limits.seconds_limit()
    for row, at in enumerate(times):
        if again and time.thread_time() > until:
            again = False
            notes.append(f"film: not searched from frame {log.frames[row]} on: too slow")
        try:
            film = _checked(log, row, by_time[at])
            if again:
                _search_again(film, 0.0 if same_host else BLOB_TOLERANCE)
        except (DecodeError, ValueError) as error:
            yield Difference(None, channels.CELLS, f"frame {log.frames[row]}: {error}")
            return


def _opencv() -> str:
    """Return the version of OpenCV on this machine."""
    try:
        from cv2 import __version__ as here
    except ImportError:
        return "missing"
    return here


def _checked(log: TrialLog, row: int, entries: list[Entry]) -> CellFilm:
    """Return the film of one picture from its messages; ValueError if anything contradicts them.

    Each robot's logged position must be within NEAR_UM of its blob, unless several cells share it.
    """
    topics = [entry.topic for entry in entries]
    if topics[:2] != [channels.CELLS, channels.CROPS] or len(set(topics)) < len(topics):
        raise ValueError("a picture has cells without crops, or crops without cells")
    cells, seen = CellCrops.FromString(entries[0].data), log.sample(row).observation
    shown = [entry.data for entry in entries[1:]]
    if cells.frame != seen.frame or list(cells.crc) != checksums(cells, seen, shown):
        raise ValueError("the checksums of cells, crops, pictures or poses do not match")
    film = decode_crops(cells, RawImage.FromString(shown[0]), seen.sampled_ns)
    camera = log.experiment.plant.microscope
    if len(film.sure) != log.valid.shape[1] or (film.robots >= len(film.sure)).any():
        raise ValueError("has a different number of robots than the trial")
    _, _, height = log.start.plant.facts.get("resolution", "").partition("x")
    if camera is None or not height.isdecimal():
        return film
    um_px, metres = camera.um_px, log.start.setup.metres
    for robot, merged, (x, y, *_) in zip(film.robots, film.merged, film.blobs, strict=True):
        if robot < 0 or merged or not log.valid[row, robot]:
            continue
        at = camera.placed((x + 0.5) * um_px, (int(height) - 0.5 - y) * um_px, metres)
        gap = np.hypot(*(log.mocap[row, robot, :2] - at)) * metres * 1e6
        if not gap <= NEAR_UM:
            raise ValueError(f"{log.start.setup.names[robot]} is {gap:.1f} um from its blob")
    return film


def _search_again(film: CellFilm, tolerance: float) -> None:
    """Search each crop again; raise ValueError if a blob found differs from the logged blob by more
    than `tolerance`.
    """
    from tetractl.lab.cameras.cells.crops import found_again  # needs OpenCV

    rows = zip(film.crops, film.corners.tolist(), film.blobs, strict=True)
    for i, (crop, corner, blob) in enumerate(rows):
        found = found_again(crop, corner, blob.tolist(), film.limits)
        if found is None or not np.allclose(found, blob, rtol=tolerance, atol=tolerance):
            raise ValueError(f"the blob found in crop {i} differs from the logged blob")
