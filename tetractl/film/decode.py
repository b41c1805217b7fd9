"""Decodes a film in a process of its own with little memory and time, so that a hostile film can
neither fill the computer's memory nor hang the command: `python -m tetractl.film.decode FILM`.

Writes a line of JSON: what the film states, or an error. Its pictures come next: height and width
as two 32-bit numbers, and the grey levels; 0 and 0 for a picture that cannot be read.
"""

import faulthandler
import json
import os
import struct
import sys
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tetractl.core.errors import AbortError, TetractlError, UsageError, printable
from tetractl.film import film_source as films

MEMORY_MAX = 320 * 2**20  # memory for decoding, beyond that of the libraries [B]
PATIENCE_S = 20.0  # longest time to read the tags, or to decode a picture [s]
PIXELS_MAX = 4096 * 4096  # largest picture that is read [px]
SIZE = struct.Struct("<II")  # of a picture
TIFFS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")  # the last two are BigTIFF
MICROSCOPES = {b"ZISR": films.czi_film, b"\xda\xce\xbe\n": films.nd2_film}


def main(path: Path, out: BinaryIO) -> None:
    """Write the film at a path."""
    faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
    try:
        source = _opened(path)
        pictures = source.pictures()
        first = next(pictures, None)
        if source.count is first is None:
            hint = "convert it to AVI, MP4 or TIFF, or give a folder of pictures"
            raise UsageError(f"{path}: OpenCV cannot read this film", hint)
        if first is not None and _large(first):
            said = f"{path.name}: a picture of {first.shape[1]} x {first.shape[0]} px"
            hint = "crop the film, or bin its pixels"
            raise UsageError(f"{said}; at most 4096 x 4096 px are read", hint)
        low, step = films.grey_scale(chain([first], source.sample()))
    except TetractlError as error:
        said = {"error": str(error), "hint": error.hint, "exit": error.exit}
        out.write(json.dumps(said).encode() + b"\n")
        return
    stated = {name: getattr(source, name) for name in source.__slots__ if name != "read"}
    out.write(json.dumps(stated).encode() + b"\n")
    for picture in chain([first], pictures):
        faulthandler.cancel_dump_traceback_later()  # the command may read slowly
        if picture is None or _large(picture):
            out.write(SIZE.pack(0, 0))
        else:
            grey = films.grey_levels(picture, low, step)
            out.write(SIZE.pack(*grey.shape) + grey.tobytes())
        faulthandler.dump_traceback_later(PATIENCE_S, exit=True)


def _large(picture: np.ndarray) -> bool:
    return picture.shape[0] * picture.shape[1] > PIXELS_MAX


def _opened(path: Path) -> films.FilmSource:
    try:
        if path.is_dir():
            from tetractl.film.tiff_film import folder_film  # slow to import

            return folder_film(path)
        with path.open("rb") as file:
            head = file.read(4)
        if head in TIFFS:
            from tetractl.film.tiff_film import tiff_film

            return tiff_film(path)
        return MICROSCOPES.get(head, films.video_film)(path)
    except (TetractlError, MemoryError):
        raise
    except ModuleNotFoundError as error:
        said, hint = f"{error.name} is not installed", "pip install 'tetractl[vision,films]'"
        raise AbortError(f"{path}: cannot be read, since {said}", hint) from error
    except Exception as error:  # the libraries do not document what they raise for damaged files
        said = printable(f"{type(error).__name__}: {error}", 100)
        raise UsageError(f"{path}: cannot be read as a film: {said}") from error


def _limit_memory() -> None:
    """Limit the memory of this process, on Linux."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        status = Path("/proc/self/status").read_text()
        most = int(status.partition("VmData:")[2].split()[0]) * 1024 + MEMORY_MAX
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))


if __name__ == "__main__":
    with os.fdopen(os.dup(1), "wb") as stream:
        os.dup2(2, 1)  # what a library prints is not part of the film
        _limit_memory()
        main(Path(sys.argv[1]), stream)
