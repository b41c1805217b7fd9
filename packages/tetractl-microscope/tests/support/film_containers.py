"""One film in the containers that microscopes and Fiji write."""

import json
from pathlib import Path

import numpy as np
import tifffile
from support.needs_opencv import cv2, video

UM_PX = 2.3
RATE_HZ = 30.0


def folder(path: Path, pictures, ending="png"):
    path.mkdir()
    for k, picture in enumerate(pictures):
        cv2.imwrite(str(path / f"picture-{k}.{ending}"), picture)
    return path


def deep(bits):
    """The pictures of a camera of so many bits, whose lowest ones are noise."""

    def made(path, pictures):
        noise = np.random.default_rng(bits).integers(0, 1 << (bits - 8), pictures.shape)
        return folder(path, (pictures.astype(np.uint16) << (bits - 8)) + noise.astype(np.uint16))

    return made


def stack(path, pictures, **options):
    tifffile.imwrite(path, pictures, photometric="minisblack", **options)
    return path


def floats(path, pictures):
    return stack(path, pictures.astype(np.float32) / 255)


def lzw(path, pictures):
    """Pages that tifffile cannot decode by itself."""
    cv2.imwritemulti(str(path), list(pictures))
    return path


def imagej(path, pictures):
    meta = {"axes": "TYX", "unit": "micron", "finterval": 1 / RATE_HZ}
    return stack(path, pictures, imagej=True, resolution=(1 / UM_PX, 1 / UM_PX), metadata=meta)


def truncated(path, pictures):
    """A hyperstack as ImageJ writes it above 4 GB: one page that describes all."""
    meta = {"axes": "ZYX", "unit": "um", "finterval": 1 / RATE_HZ}
    tifffile.imwrite(
        path,
        pictures[:, None],
        imagej=True,
        resolution=(1 / UM_PX, 1 / UM_PX),
        metadata=meta | {"axes": "ZCYX"},
        contiguous=True,
        truncate=True,
    )
    return path


def times_ms(count):
    return [1000 * k / RATE_HZ for k in range(count)]


def ome(path, pictures):
    meta = {"axes": "TYX", "PhysicalSizeX": UM_PX * 1000, "PhysicalSizeXUnit": "nm"}
    delta = {"DeltaT": times_ms(len(pictures)), "DeltaTUnit": ["ms"] * len(pictures)}
    return stack(path, pictures, ome=True, metadata=meta | {"Plane": delta})


def ome_split(path, pictures):
    """Two files, of which each names the other, as Micro-Manager writes them."""
    path.mkdir()
    names = ["dish_MMStack_Pos0.ome.tif", "dish_MMStack_Pos0_1.ome.tif"]
    count = len(pictures)
    half = len(pictures) // 2
    planes = "".join(
        f'<TiffData FirstT="{k}" IFD="{k % half}" PlaneCount="1">'
        f'<UUID FileName="{names[k // half]}">urn:uuid:{k // half}</UUID></TiffData>'
        f'<Plane TheT="{k}" TheC="0" TheZ="0" DeltaT="{t}" DeltaTUnit="ms"/>'
        for k, t in enumerate(times_ms(count))
    )
    height, width = pictures.shape[1:]
    for i, name in enumerate(names):
        xml = (
            '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" '
            f'UUID="urn:uuid:{i}"><Image ID="Image:0"><Pixels ID="Pixels:0" Type="uint8" '
            f'DimensionOrder="XYCZT" SizeX="{width}" SizeY="{height}" SizeC="1" SizeZ="1" '
            f'SizeT="{count}" PhysicalSizeX="{UM_PX}"><Channel ID="Channel:0"/>{planes}'
            "</Pixels></Image></OME>"
        )
        part = pictures[i * half : (i + 1) * half]
        stack(path / name, part, description=xml, metadata=None)
    return path


def micro_manager(path, pictures):
    """Two files that do not name each other; each page has the metadata of its picture."""
    path.mkdir()
    half = len(pictures) // 2
    for i in range(2):
        with tifffile.TiffWriter(path / f"dish_MMStack_{i + 1}.tif") as tif:
            for k in range(i * half, (i + 1) * half):
                meta = {
                    "FrameIndex": k, "ElapsedTime-ms": times_ms(k + 1)[k], "PixelSizeUm": UM_PX
                }  # fmt: skip
                text = json.dumps(meta).encode() + b"\0"
                tag = (51123, 2, len(text), text, True)
                tif.write(pictures[k], photometric="minisblack", extratags=[tag], metadata=None)
    return path


def ffv1(path, pictures):
    """It keeps each grey level."""
    return video(path, pictures, RATE_HZ, "FFV1")


# name: (writer, does it state the scale, does it state the rate)
CONTAINERS = {
    "png": (folder, False, False),
    "camera of 12 bits": (deep(12), False, False),
    "camera of 16 bits": (deep(16), False, False),
    "stack.tif": (stack, False, False),
    "deep.tif": (lambda path, p: stack(path, p.astype(np.uint16) * 257), False, False),
    "floats.tif": (floats, False, False),
    "lzw.tif": (lzw, False, False),
    "zlib.tif": (lambda path, p: stack(path, p, compression="zlib"), False, False),
    "imagej.tif": (imagej, True, True),
    "big imagej.tif": (truncated, True, True),
    "film.ome.tif": (ome, True, True),
    "split OME": (ome_split, True, True),
    "split Micro-Manager": (micro_manager, True, False),
    "film.avi": (ffv1, False, True),
}
