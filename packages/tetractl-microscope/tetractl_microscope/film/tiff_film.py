"""Opens TIFF films by `tifffile`: stacks of pages, ImageJ's hyperstacks, OME-TIFF and the files of
Micro-Manager, also split over several files; and folders of pictures.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
from tifffile import TiffFile, memmap, natural_sorted

from tetractl.core.errors import UsageError
from tetractl_microscope.film.film_source import FilmSource, Raw, scaled

TIFF = frozenset({".tif", ".tiff"})
PICTURES = TIFF | {".png", ".jpg", ".jpeg", ".bmp", ".pgm"}
ANY_GREY = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE
MICRO_MANAGER = 51123  # tag of a page's metadata, JSON


def tiff_film(path: Path) -> FilmSource:
    """Open a TIFF file, and those that its tags name, as a film."""
    tif = TiffFile(path)
    series: Any = tif.series[0]
    inside = len(series.keyframe.shape)
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
    _add_tags(tif, series, source)
    return source


def folder_film(folder: Path) -> FilmSource:
    """Open a folder of pictures in the order of the numbers in their names; a TIFF file gives all
    its pages, the first one also scale and rate, or all files that its tags name.
    """
    found = (path for path in folder.iterdir() if path.suffix.lower() in PICTURES)
    names = [folder / name for name in natural_sorted(p.name for p in found if p.is_file())]
    if not names:
        hint = f"names of pictures end in {', '.join(sorted(PICTURES))}"
        raise UsageError(f"{folder}: contains no pictures", hint)
    pages: list[tuple[Path, int]] = []
    source = FilmSource(lambda index: _page(*pages[index]))
    for path in names:
        count = 1
        if path.suffix.lower() in TIFF:
            with suppress(Exception), TiffFile(path) as tif:  # what it raises is not documented
                if path == names[0] and tif.series[0].is_multifile:
                    return tiff_film(path)
                count = len(tif.pages)
                if path == names[0]:
                    _add_tags(tif, tif.series[0], source)
        pages += [(path, page) for page in range(count)]
    source.count = len(pages)
    return source


def _page(path: Path | str, index: int) -> Raw:
    """Return the pixels (height, width) of a page of a file that OpenCV reads."""
    return cv2.imreadmulti(str(path), index, 1, flags=ANY_GREY)[1][0]


def _pixels(page: Any) -> Raw:
    """Return the pixels of a page (height, width), or (height, width, samples) in colour."""
    if _absent(page):
        return None
    try:
        pixels = page.asarray()
    except ValueError:  # LZW and JPEG need another package, but OpenCV reads them
        return _page(page.parent.filehandle.path, page.index)
    return np.moveaxis(pixels, 0, -1) if page.keyframe.axes == "SYX" else pixels


def _absent(page: Any) -> bool:
    return page is None or not page.dataoffsets or page.dataoffsets[0] == 0


def _add_tags(tif: TiffFile, series: Any, source: FilmSource) -> None:
    """Add what OME-XML, Micro-Manager and ImageJ state, the first of these that states it."""
    imagej = tif.imagej_metadata or {}
    summary = (tif.micromanager_metadata or {}).get("Summary", {})
    xml = ElementTree.fromstring(tif.ome_metadata or "<none/>").find(".//{*}Pixels")
    ome = {} if xml is None else xml.attrib
    pages = list(_page_metadata(series)) if tif.is_micromanager else []
    per_unit, of = series.keyframe.tags["XResolution"].value if "unit" in imagej else (0, 1)
    source.um_px = (
        scaled(ome.get("PhysicalSizeX"), ome.get("PhysicalSizeXUnit", "um"))
        or scaled((pages or [{}])[0].get("PixelSizeUm"), "um")
        or scaled(summary.get("PixelSize_um"), "um")
        or scaled(of / per_unit if per_unit else None, imagej.get("unit"))
    )
    interval_s = (
        scaled(ome.get("TimeIncrement"), ome.get("TimeIncrementUnit", "s"))
        or scaled(summary.get("Interval_ms"), "ms")
        or scaled(imagej.get("finterval"), imagej.get("tunit", "s"))
    )
    source.rate_hz = 1 / (interval_s or math.inf)
    times: dict[int, float | None] = {}
    for page in pages:
        at = scaled(page.get("ElapsedTime-ms"), "ms")
        times.setdefault(int(page.get("FrameIndex", len(times))), at)
    along = "T" if ome.get("SizeT") != "1" else max("ZC", key=lambda a: int(ome.get(f"Size{a}", 0)))
    for plane in () if xml is None else xml.iterfind("{*}Plane"):
        if all(plane.get(f"The{axis}", "0") == "0" for axis in "TZC" if axis != along):
            at = scaled(plane.get("DeltaT"), plane.get("DeltaTUnit", "s"))
            times[int(plane.get(f"The{along}", 0))] = at
    source.add_times([times.get(i) for i in range(source.count or 0)])


def _page_metadata(series: Any) -> Iterator[dict[str, Any]]:
    """Yield Micro-Manager's metadata of each page, in all files of a film."""
    for path in dict.fromkeys(page.parent.filehandle.path for page in series if page is not None):
        with TiffFile(path) as tif:
            page: Any
            for page in tif.pages:
                if MICRO_MANAGER in page.tags:
                    yield page.tags[MICRO_MANAGER].value
