"""Encodes a microscope's film for a log: cells found, crops, and whole pictures.

`/camera/cells` describes each crop and has the checksums of all messages of its picture. Crops are
stored as raw pixels, so that the search in them can be repeated; the log's chunks are compressed
anyway. Whole pictures are JPEG, for display.
"""

import zlib
from collections.abc import Iterable

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import Message

from tetractl.core.cell_film import CellFilm
from tetractl.core.poses import Grey, Observation
from tetractl.log.format import channels
from tetractl.log.format.scene import stamp
from tetractl.log.format.tetractl_pb2 import CellCrops

LENS = "microscope"
"""Name of the images' coordinate frame."""


def encode_film(film: CellFilm, seen: Observation, start_ns: int) -> dict[str, Message]:
    """Return the messages of one picture of the film, by topic.

    `seen` is the camera frame of the picture; the trial starts at `start_ns` [Unix ns].
    """
    time, side = stamp(start_ns + seen.sampled_ns), film.crops.shape[2]
    crops = RawImage(
        timestamp=time, frame_id=LENS, width=side, height=len(film.crops) * side,
        encoding="mono8", step=side, data=film.crops.tobytes(),
    )  # fmt: skip
    shown: dict[str, Message] = {channels.CROPS: crops}
    for topic, picture in ((channels.PICTURE, film.whole), (channels.BACKGROUND, film.background)):
        if picture is not None:
            shown[topic] = jpeg_image(picture, start_ns + seen.sampled_ns)
    low, high, least, most = film.limits
    x, y, axis, long, wide, strength = film.blobs.reshape(-1, 6).T.tolist()
    cells = CellCrops(
        frame=seen.frame, side=side, low=low, high=high, least_px2=least, most_px2=most,
        robot=film.robots.tolist(), merged=film.merged.tolist(), sure=film.sure.tolist(),
        column=film.corners[:, 0].tolist(), row=film.corners[:, 1].tolist(),
        x=x, y=y, axis=axis, long=long, wide=wide, strength=strength,
    )  # fmt: skip
    data = (message.SerializeToString() for message in shown.values())
    cells.crc.extend(checksums(cells, seen, data))
    return {channels.CELLS: cells, **shown}


def checksums(cells: CellCrops, seen: Observation, shown: Iterable[bytes]) -> list[int]:
    """Return checksums (CRC-32): one of the cells found together with the poses of their frame,
    then one of each image.
    """
    bare = CellCrops.FromString(cells.SerializeToString())
    bare.ClearField("crc")
    poses = np.column_stack([seen.poses.array(), seen.valid]).tobytes()
    return [zlib.crc32(poses, zlib.crc32(bare.SerializeToString())), *map(zlib.crc32, shown)]


def decode_crops(cells: CellCrops, crops: RawImage, sampled_ns: int) -> CellFilm:
    """Decode the cells found and their crops; ValueError if cells and crops do not match."""
    columns = (cells.x, cells.y, cells.axis, cells.long, cells.wide, cells.strength)
    others = (cells.robot, cells.merged, cells.column, cells.row)
    count, side = len(cells.robot), cells.side
    if {len(column) for column in (*columns, *others)} != {count}:
        raise ValueError("columns have different lengths")
    if side < 1 or len(crops.data) != count * side * side:
        raise ValueError(f"{len(crops.data)} bytes are not {count} crops of {side} pixels per side")
    return CellFilm(
        sampled_ns=sampled_ns,
        crops=np.frombuffer(crops.data, np.uint8).reshape(count, side, side),
        corners=np.array([cells.column, cells.row], dtype=np.int64).T.reshape(count, 2),
        blobs=np.array(columns, dtype=np.float64).T.reshape(count, 6),
        robots=np.array(cells.robot, np.int64),
        merged=np.array(cells.merged, np.bool_),
        limits=(cells.low, cells.high, cells.least_px2, cells.most_px2),
        sure=np.array(cells.sure, np.float64),
    )


def jpeg_image(picture: Grey, unix_ns: int) -> CompressedImage:
    """Encode a whole picture, for display."""
    import cv2  # imported here: logs without films do not need OpenCV

    # JPEG quality of whole pictures
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])
    coded = data.tobytes() if done else b""
    return CompressedImage(timestamp=stamp(unix_ns), frame_id=LENS, data=coded, format="jpeg")
