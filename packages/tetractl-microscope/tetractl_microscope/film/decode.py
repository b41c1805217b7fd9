"""Decodes a film in a process of its own with little memory and time, so that a hostile film can
neither fill the computer's memory nor hang the command:
`python -m tetractl_microscope.film.decode FILM`.

The time is that of the processor, so that no film is refused because the computer is busy; what
would wait without end, a pipe, is not opened. One thread decodes, so that the memory a film needs
does not depend on how many processors the computer has.

Writes what the film states and an error, one of which is None, and then its pictures: grey levels
(height, width), or None for one that is damaged, or not as large as most; each with the time from
the first [s] that its container's clock states, or None; all by `pickle`.
"""

import math
import os
import pickle
import signal
import sys
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from statistics import mode
from typing import Any, BinaryIO

import cv2

from tetractl.core.errors import AbortError, TetractlError, UsageError, printable
from tetractl_microscope.film import film_source as films

MEMORY_MAX = 320 * 2**20  # memory for decoding, beyond that of the libraries [B]
# longest time of the processor to read the tags, or to decode a picture [s]; chosen: 24 noisy
# pictures of 2048 x 2048 px take 0.6 s as mp4v
PATIENCE_S = 20.0
TIFFS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")  # the last two are BigTIFF
NO_SIZE = (0, 0)  # of a picture that cannot be read
NOT_READ = {
    b"<?xm": ("is XML, and no film", "of TrackMate, export the table of spots, or a GEFF graph"),
    b"PK\3\4": ("is a zip archive, and no film", "unpack it"),
    b"ZISR": ("is a film of Zeiss, CZI, which is not read", "export it as OME-TIFF"),
}
"""By their first bytes, files that are not read: what they are, and what to do."""
ND2 = b"\xda\xce\xbe\n"


def main(path: Path, out: BinaryIO) -> None:
    """Write the film at a path."""
    _limit_time()
    try:
        source = _opened(path)
        pictures = source.pictures()
        first = list(islice(pictures, 1))
        if not first:
            hint = "convert it to AVI, MP4 or TIFF, or give a folder of pictures"
            raise UsageError(f"{path}: OpenCV cannot read this film", hint)
        looked = [films.thinned(pixels) for pixels in chain(first, source.sample())]
        sizes = [size for size, _ in looked[1:] or looked if size != NO_SIZE]  # the first is twice
        size = mode(sizes) if sizes else NO_SIZE  # an odd picture may come first
        if math.prod(size) > films.PIXELS_MAX:
            said = f"{path.name}: a picture of {size[1]} x {size[0]} px"
            hint = "crop the film, or bin its pixels"
            raise UsageError(f"{said}; at most 4096 x 4096 px are read", hint)
        low, step = films.grey_scale(pixels for its_size, pixels in looked if its_size == size)
    except TetractlError as error:
        pickle.dump((None, error), out)
        return
    begin_s = source.clock_s
    stated = {name: getattr(source, name) for name in source.__slots__ if name != "read"}
    pickle.dump((stated, None), out)
    for pixels in chain(first, pictures):
        shape = NO_SIZE if pixels is None else pixels.shape[:2]
        size = shape if size == NO_SIZE else size
        if pixels is None or shape != size or math.prod(shape) > films.PIXELS_MAX:
            grey = None
        else:
            grey = films.grey_levels(pixels, low, step)
        now_s = source.clock_s
        passed_s = None if begin_s is None or now_s is None else now_s - begin_s
        pickle.dump((grey, passed_s), out)
        _limit_time()


def _opened(path: Path) -> films.FilmSource:
    try:
        if path.is_dir():
            from tetractl_microscope.film.tiff_film import folder_film  # slow to import

            return folder_film(path)
        with path.open("rb") as file:
            head = file.read(4)
        if head in TIFFS:
            from tetractl_microscope.film.tiff_film import tiff_film

            return tiff_film(path)
        if head in NOT_READ:
            said, hint = NOT_READ[head]
            raise UsageError(f"{path}: {said}", hint)
        return films.nd2_film(path) if head == ND2 else films.video_film(path)
    except (TetractlError, MemoryError):
        raise
    except ModuleNotFoundError as error:
        said = f"{error.name} is not installed"
        hint = "pip install './packages/tetractl-microscope[films]'"
        raise AbortError(f"{path}: cannot be read, since {said}", hint) from error
    except Exception as error:  # the libraries do not document what they raise for damaged files
        said = printable(f"{type(error).__name__}: {error}", 100)
        raise UsageError(f"{path}: cannot be read as a film: {said}") from error


def _limit_time() -> None:
    """Let this process be ended once it has used the processor for PATIENCE_S from now on; Windows
    has no such limit.
    """
    if sys.platform != "win32":
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_PROF, PATIENCE_S)


def _refuse_pipe(event: str, arguments: tuple[Any, ...]) -> None:
    """Raise OSError if a pipe is about to be opened, which would wait for one who writes to it: the
    tags of a film may name one. An audit hook of Python.
    """
    if event == "open" and isinstance(arguments[0], str | bytes):
        path = Path(os.fsdecode(arguments[0]))
        if path.is_fifo():
            raise OSError(f"{path} is a pipe")


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
        sys.addaudithook(_refuse_pipe)
        cv2.setNumThreads(1)  # each thread takes memory
        _limit_memory()
        main(Path(sys.argv[1]), stream)
