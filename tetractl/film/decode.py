"""Decodes a film in a process of its own with little memory and time, so that a hostile film can
neither fill the computer's memory nor hang the command: `python -m tetractl.film.decode FILM`.

Writes a line of JSON: what the film states and its grey levels (low, step), or an error. If `LOW
STEP` follow FILM, its pictures come next: height and width as two 32-bit numbers, and the grey
levels; 0 and 0 for a picture that cannot be read.
"""

import faulthandler
import json
import os
import signal
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from tetractl.core.errors import AbortError, TetractlError, UsageError, printable
from tetractl.film import film_source as films

MEMORY_MAX = 320 * 2**20  # memory for decoding, beyond that of the libraries [B]
PATIENCE_S = 20.0  # longest time to read the tags, or to decode a picture [s]
SIZE = struct.Struct("<II")  # of a picture
TIFFS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")  # the last two are BigTIFF
MICROSCOPES = {b"ZISR": films.czi_film, b"\xda\xce\xbe\n": films.nd2_film}


def main(words: list[str], out: BinaryIO) -> None:
    """Write the film that `words` name."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command ends this process
    faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
    _limit_memory()
    try:
        source = _opened(Path(words[0]))
        low, step = map(
            float, words[1:] or films.grey_scale(_watched(source.pictures(films.SAMPLED)))
        )
    except TetractlError as error:
        said = {"error": str(error), "hint": error.hint, "exit": error.exit}
        out.write(json.dumps(said).encode() + b"\n")
        return
    stated = {name: getattr(source, name) for name in source.__slots__ if name != "read"}
    out.write(json.dumps(stated | {"levels": (low, step)}).encode() + b"\n")
    for picture in _watched(source.pictures()) if words[1:] else ():
        if picture is None or picture.shape[0] * picture.shape[1] > films.PIXELS_MAX:
            out.write(SIZE.pack(0, 0))
        else:
            grey = films.grey_levels(picture, low, step)
            out.write(SIZE.pack(*grey.shape) + grey.tobytes())


def _watched(pictures: Iterator[films.Raw]) -> Iterator[films.Raw]:
    """Yield pictures, each of which may take PATIENCE_S to be read."""
    for picture in pictures:
        faulthandler.cancel_dump_traceback_later()
        yield picture
        faulthandler.dump_traceback_later(PATIENCE_S, exit=True)


def _opened(path: Path) -> films.FilmSource:
    try:
        head = b"" if path.is_dir() else _head(path)
        if path.is_dir() or head in TIFFS:
            from tetractl.film.tiff_film import folder_film, tiff_film  # slow to import

            return tiff_film(path) if head else folder_film(path)
        return MICROSCOPES.get(head, films.video_film)(path)
    except (TetractlError, MemoryError):
        raise
    except ModuleNotFoundError as error:
        said, hint = f"{error.name} is not installed", "pip install 'tetractl[vision,films]'"
        raise AbortError(f"{path}: cannot be read, since {said}", hint) from error
    except Exception as error:  # the libraries do not document what they raise for damaged files
        said = printable(f"{type(error).__name__}: {error}", 100)
        raise UsageError(f"{path}: cannot be read as a film: {said}") from error


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(4)


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
        main(sys.argv[1:], stream)
