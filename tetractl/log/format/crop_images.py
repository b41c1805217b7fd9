"""A microscope's film in a log: what was found, crops, and whole pictures.

`/camera/cells` says what each crop is and repeats the checksums of the pictures, so that none can
be changed by itself. Crops are not compressed: chunks are, and nothing has to be decoded to search
them again. Whole pictures are JPEG, for people.
"""

import zlib
from collections.abc import Sequence

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from tetractl.core.cell_film import CellFilm
from tetractl.core.poses import Grey, Observation
from tetractl.log.format import channels
from tetractl.log.format.scene import stamp
from tetractl.log.format.tetractl_pb2 import CellCrops

QUALITY = 80  # of whole pictures, as JPEG counts
LENS = "microscope"
"""The coordinate frame of the images."""


def encode_film(
    film: CellFilm, seen: Observation, start_ns: int
) -> tuple[CellCrops, RawImage, dict[str, CompressedImage]]:
    """Return what was found in a picture, its crops, and pictures by topic.

    `seen` is what the log says of its frame, of a trial that starts at a time [Unix ns].
    """
    count, side = len(film.crops), film.crops.shape[2]
    time = stamp(start_ns + seen.sampled_ns)
    crops = RawImage(
        timestamp=time, frame_id=LENS, width=side, height=count * side, encoding="mono8",
        step=side, data=film.crops.tobytes(),
    )  # fmt: skip
    low, high, least, most = film.limits
    x, y, axis, long, wide, strength = film.blobs.reshape(-1, 6).T.tolist()
    message = CellCrops(
        frame=seen.frame, side=side, low=low, high=high, least_px2=least, most_px2=most,
        robot=film.robots.tolist(), merged=film.merged.tolist(), sure=film.sure.tolist(),
        column=film.corners[:, 0].tolist(), row=film.corners[:, 1].tolist(),
        x=x, y=y, axis=axis, long=long, wide=wide, strength=strength,
        crc=_checksums(film, seen),
    )  # fmt: skip
    pictures: dict[str, CompressedImage] = {}
    for topic, picture in ((channels.PICTURE, film.whole), (channels.BACKGROUND, film.background)):
        if picture is not None:
            data = _jpeg(picture)
            message.picture_crc.append(zlib.crc32(data))
            image = CompressedImage(timestamp=time, frame_id=LENS, data=data, format="jpeg")
            pictures[topic] = image
    return message, crops, pictures


def decode_crops(cells: CellCrops, crops: RawImage, sampled_ns: int) -> CellFilm:
    """Decode what was found and its crops; ValueError where they do not fit together."""
    columns = (cells.x, cells.y, cells.axis, cells.long, cells.wide, cells.strength)
    others = (cells.robot, cells.merged, cells.column, cells.row)
    count, side = len(cells.robot), cells.side
    if {len(column) for column in (*columns, *others)} != {count}:
        raise ValueError("columns of several lengths")
    if side < 1 or len(crops.data) != count * side * side:
        raise ValueError(f"{len(crops.data)} bytes are not {count} crops of {side} pixels a side")
    return CellFilm(
        sampled_ns=sampled_ns,
        crops=np.frombuffer(crops.data, np.uint8).reshape(count, side, side),
        corners=_paired(cells.column, cells.row),
        blobs=np.array(columns, dtype=np.float64).T.reshape(count, 6),
        robots=np.array(cells.robot, np.int64),
        merged=np.array(cells.merged, np.bool_),
        limits=(cells.low, cells.high, cells.least_px2, cells.most_px2),
        sure=np.array(cells.sure, np.float64),
    )


def _paired(one: Sequence[int], other: Sequence[int]) -> np.ndarray:
    return np.column_stack([one, other]).astype(np.int64).reshape(-1, 2)


def _checksums(film: CellFilm, seen: Observation) -> list[int]:
    """Return a checksum of what is said of the picture, and one of each crop and its numbers."""
    numbers = [*film.limits, *film.sure, *seen.poses.array().ravel(), *seen.valid]
    shared = zlib.crc32(np.array(numbers, dtype=np.float64).tobytes())
    said = np.column_stack([film.blobs, film.corners, film.robots, film.merged]).astype(float)
    rows = zip(film.crops, said, strict=True)
    return [shared, *(zlib.crc32(row.tobytes(), zlib.crc32(crop.tobytes())) for crop, row in rows)]


def _jpeg(picture: Grey) -> bytes:
    import cv2  # such a picture comes of a camera that needs it; a log without one does not

    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data.tobytes() if done else b""
