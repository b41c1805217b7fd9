"""A film in Matroska's container, in which each picture has a time of its own."""

import struct

from support.needs_opencv import cv2

UNKNOWN = b"\x01" + 7 * b"\xff"  # size of an element that ends with the file


def element(name, body):
    """An element of EBML: identifier, length in 8 bytes, content."""
    return bytes.fromhex(name) + struct.pack(">Q", len(body) | 1 << 56) + body


def number(name, value):
    return element(name, struct.pack(">Q", value))


def matroska(path, pictures, times_s):
    """Write pictures (height, width) as JPEG, at times in whole milliseconds."""
    height, width = pictures[0].shape
    versions = number("4287", 4) + number("4285", 2)
    head = element("1A45DFA3", element("4282", b"matroska") + versions)
    info = element("1549A966", number("2AD7B1", 1_000_000))  # a unit of time is 1 ms
    video = element("E0", number("B0", width) + number("BA", height))
    first_video = number("D7", 1) + number("73C5", 1) + number("83", 1)
    track = first_video + element("86", b"V_MJPEG")
    tracks = element("1654AE6B", element("AE", track + video))
    clusters = b""
    for picture, time_s in zip(pictures, times_s, strict=True):
        jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
        block = element("A3", b"\x81" + struct.pack(">hB", 0, 0x80) + jpeg)
        clusters += element("1F43B675", number("E7", round(1000 * time_s)) + block)
    path.write_bytes(head + bytes.fromhex("18538067") + UNKNOWN + info + tracks + clusters)
    return path
