"""Opens TIFF films by `tifffile`: stacks of pages, ImageJ's hyperstacks, OME-TIFF and the files of
Micro-Manager, also split over several files; and folders of pictures.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
from tifffile import COMPRESSION, PHOTOMETRIC, TiffFile, memmap, natural_sorted

from tetractl.core.errors import UsageError
from tetractl_microscope.film.film_source import FilmSource, Raw, micrometres
from tetractl_microscope.film.picture_names import TIMES_FILE, places_of, require_one_film

TIFFS = frozenset({".tif", ".tiff"})
PICTURES = TIFFS | {".png", ".jpg", ".jpeg", ".bmp", ".pgm"}
ANY_GREY = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE
MICRO_MANAGER = 51123  # tag of a page's metadata, JSON
OF_OPENCV = frozenset({
    COMPRESSION.NONE, COMPRESSION.LZW, COMPRESSION.JPEG, COMPRESSION.OJPEG, COMPRESSION.DEFLATE,
    COMPRESSION.ADOBE_DEFLATE, COMPRESSION.PACKBITS, COMPRESSION.CCITTRLE, COMPRESSION.CCITT_T4,
    COMPRESSION.CCITT_T6,
})  # fmt: skip
"""Compressions that OpenCV reads; of others it returns black pictures."""
IMAGECODECS = "imagecodecs"  # package by which tifffile decodes most compressions


def tiff_film(path: Path) -> FilmSource:
    """Open a TIFF file, and those that its tags name, as a film."""
    tif = TiffFile(path)
    several: Any = tif.series
    if not several:
        raise UsageError(f"{path}: is a TIFF file without pictures", "is it cut short?")
    which = int(np.argmax([len(pages) for pages in several]))  # a thumbnail may come first
    series = several[which]
    inside = len(series.keyframe.shape)
    stated = int((tif.imagej_metadata or {}).get("images", 1))
    has = math.prod(series.shape[:-inside])
    if stated > has:
        said = f"{path}: states {stated} pictures, and has {has} that can be found"
        raise UsageError(said, "is it cut short?")
    planes: Any = series
    if series.is_truncated:  # ImageJ above 4 GB describes the first page only
        planes = memmap(path, mode="r").reshape(-1, *series.keyframe.shape)

    def read(index: int) -> Raw:
        plane = planes[chosen[index]]
        return np.array(plane) if series.is_truncated else _pixels(plane)

    source = FilmSource(read)
    chosen = source.over_time(series.axes[:-inside], series.shape[:-inside])
    while not series.is_truncated and chosen and _absent(series[chosen[-1]]):
        chosen.pop()  # the microscope was stopped before the planned end
    source.count = len(chosen)
    if len(several) > 1:
        source.remarks.append(f"the longest of its {len(several)} series of pictures is read")
    _require_codec(source)
    _add_tags(tif, which, source)
    return source


def folder_film(folder: Path) -> FilmSource:
    """Open a folder of pictures in the order of the numbers in their names; a TIFF file gives all
    its pages, the first one also scale and rate, or all files that its tags name.
    """
    files = (path for path in folder.iterdir() if path.suffix.lower() in PICTURES)
    # those that begin with a dot, such as `._img_0001.png` of macOS, are no pictures
    names = natural_sorted(p.name for p in files if p.is_file() and not p.name.startswith("."))
    if not names:
        hint = f"names of pictures end in {', '.join(sorted(PICTURES))}"
        raise UsageError(f"{folder}: contains no pictures", hint)
    pages: list[tuple[Path, int, bool]] = []
    times: list[float | None] = []
    source = FilmSource(lambda index: _picture(*pages[index]))
    for name in names:
        path = folder / name
        count = 1
        by_opencv = True
        if path.suffix.lower() in TIFFS:
            with suppress(Exception), TiffFile(path) as tif:  # what it raises is not documented
                if name == names[0]:
                    if tif.series[0].is_multifile:
                        return tiff_film(path)
                    _add_tags(tif, 0, source)
                count = len(tif.pages)
                first: Any = tif.pages[0]
                is_palette = first.keyframe.photometric == PHOTOMETRIC.PALETTE  # it gives colours
                by_opencv = first.keyframe.compression in OF_OPENCV and not is_palette
                times += [
                    source.seconds(stated.get("ElapsedTime-ms"), "ms")
                    for stated in map(_micro_manager, tif.pages)
                ]
        pages += [(path, page, by_opencv) for page in range(count)]
    if not (folder / TIMES_FILE).exists():
        require_one_film(folder, names)
        if len(pages) == len(names):
            source.places = places_of(folder, names, source.remarks)
    source.count = len(pages)
    _require_codec(source)
    if any(time is not None for time in times) and len(times) == len(pages):
        source.add_times(times)
    return source


def _page(path: Path | str, index: int) -> Raw:
    """Return the pixels (height, width) of a page of a file that OpenCV reads."""
    return cv2.imreadmulti(str(path), index, 1, flags=ANY_GREY)[1][0]


def _picture(path: Path, index: int, by_opencv: bool) -> Raw:
    """Return the pixels of a page of a file in a folder."""
    if by_opencv:
        return _page(path, index)
    with TiffFile(path) as tif:
        return _pixels(tif.pages[index])


def _require_codec(source: FilmSource) -> None:
    """Raise UsageError if the pictures need a package that is not installed."""
    try:
        source.read(0)
    except UsageError:
        raise
    except Exception:  # the picture is damaged; the libraries do not document what they raise
        return


def _pixels(page: Any) -> Raw:
    """Return the pixels of a page (height, width), or (height, width, samples) in colour. Of one in
    which 0 is white, cells are as bright as they are dark otherwise: either are found.

    UsageError if its compression needs a package that is not installed.
    """
    if _absent(page):
        return None
    try:
        pixels = page.asarray()
    except (ValueError, ImportError) as error:
        if page.compression in OF_OPENCV:  # such as LZW and JPEG, which need another package
            return _page(page.parent.filehandle.path, page.index)
        if isinstance(error, ImportError) or IMAGECODECS in str(error):
            raise _codec_missing(page) from error
        raise
    return np.moveaxis(pixels, 0, -1) if page.keyframe.axes == "SYX" else pixels


def _axis_of_time(ome: Mapping[str, str]) -> str:
    """Return the axis T of an OME-TIFF, or else that of Z and C which has more planes, if it states
    one time: some programs store a film so.
    """
    if ome.get("SizeT") != "1":
        return "T"
    depth = int(ome.get("SizeZ", 0))
    channels = int(ome.get("SizeC", 0))
    return "C" if channels > depth else "Z"


def _codec_missing(page: Any) -> UsageError:
    names = [page.compression]
    if page.predictor > 1:
        names.append(page.predictor)
    coded = " with ".join(str(getattr(code, "name", code)) for code in names)
    return UsageError(
        f"{page.parent.filehandle.path}: its pictures are compressed by {coded}, which needs "
        f"{IMAGECODECS}",
        f"pip install {IMAGECODECS}, or save the film without compression",
    )


def _absent(page: Any) -> bool:
    return page is None or not page.dataoffsets or page.dataoffsets[0] == 0


def _add_tags(tif: TiffFile, which: int, source: FilmSource) -> None:
    """Add what OME-XML, Micro-Manager and ImageJ state of a series of a file, the first of these
    that states it.
    """
    series: Any = tif.series[which]
    imagej = tif.imagej_metadata or {}
    summary = (tif.micromanager_metadata or {}).get("Summary", {})
    images = ElementTree.fromstring(tif.ome_metadata or "<none/>").findall(".//{*}Pixels")
    xml = images[which] if which < len(images) else None
    ome = {} if xml is None else xml.attrib
    pages = list(_page_metadata(series)) if tif.is_micromanager else []
    per_unit, resolution_unit = (
        series.keyframe.tags["XResolution"].value if "unit" in imagej else (0, 1)
    )
    source.um_px = (
        micrometres(ome.get("PhysicalSizeX"), ome.get("PhysicalSizeXUnit", "um"))
        or micrometres((pages or [{}])[0].get("PixelSizeUm"), "um")
        or micrometres(summary.get("PixelSize_um"), "um")
        or micrometres(resolution_unit / per_unit if per_unit else None, imagej.get("unit"))
    )
    interval_s = (
        source.seconds(ome.get("TimeIncrement"), ome.get("TimeIncrementUnit", "s"))
        or source.seconds(summary.get("Interval_ms"), "ms")
        or source.seconds(imagej.get("finterval"), imagej.get("tunit", "s"))
    )
    source.rate_hz = 1 / (interval_s or math.inf)
    times: dict[int, float | None] = {}
    for page in pages:
        seconds = source.seconds(page.get("ElapsedTime-ms"), "ms")
        number = int(page.get("FrameIndex", len(times)))
        times.setdefault(number, seconds)
    along = _axis_of_time(ome)
    for plane in () if xml is None else xml.iterfind("{*}Plane"):
        if all(plane.get(f"The{axis}", "0") == "0" for axis in "TZC" if axis != along):
            seconds = source.seconds(plane.get("DeltaT"), plane.get("DeltaTUnit", "s"))
            times[int(plane.get(f"The{along}", 0))] = seconds
    if times:
        source.add_times([times.get(i) for i in range(source.count or 0)])


def _micro_manager(page: Any) -> dict[str, Any]:
    """Return what Micro-Manager states of a page, nothing if it did not write it."""
    return page.tags[MICRO_MANAGER].value if MICRO_MANAGER in page.tags else {}


def _page_metadata(series: Any) -> Iterator[dict[str, Any]]:
    """Yield Micro-Manager's metadata of each page, in all files of a film."""
    for path in dict.fromkeys(page.parent.filehandle.path for page in series if page is not None):
        with TiffFile(path) as tif:
            yield from filter(None, map(_micro_manager, tif.pages))
