"""Reads a microscope's camera through Micro-Manager's core, `pymmcore`.

It was not tested with a real camera. According to its documentation, the core fills a circular
buffer while a sequence of images is taken. This feed removes each image at once, so that no image
waits in the buffer. `PictureCamera` skips and counts the images for which its search is too slow.
"""

import os
import re
import sys
import threading
from contextlib import chdir
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import AbortError
from tetractl_microscope.pictures.feed import Feed, Picture, SourceEndedError
from tetractl_microscope.pictures.picture_section import MicroManagerSource

FOLDER = "MICROMANAGER_PATH"
"""Environment variable that names the folder where Micro-Manager is installed."""
INSTALLED = {
    "win32": "C:/Program Files/Micro-Manager-2.0",
    "darwin": "/Applications/Micro-Manager",
    "linux": "/usr/local/lib/micro-manager",
}
CONFIG_MAX = 1 << 24  # largest size of a configuration [bytes]
LIBRARY = {"win32": "mmgr_dal_{}.dll", "darwin": "libmmgr_dal_{}"}.get(
    sys.platform, "libmmgr_dal_{}.so.0"
)
"""Name of the library of a device adapter, as the core makes it."""
FAILURES = (OSError, RuntimeError, ValueError)  # as pymmcore raises them, by the kind of error
_PLACE = re.compile(r"[/\\]|^\.\.$")


def adapter_folder() -> Path:
    """Find the folder of Micro-Manager's device adapters, whose libraries the core runs.

    No spec can name this folder.

    Raises:
        AbortError: If Micro-Manager is not installed.
    """
    folder = Path(os.environ.get(FOLDER) or INSTALLED.get(sys.platform, INSTALLED["linux"]))
    if not folder.is_dir():
        hint = f"tell tetractl the folder of Micro-Manager: {FOLDER}=FOLDER tetractl ..."
        raise AbortError(f"Micro-Manager is not installed in {folder}", hint)
    return folder.resolve()


def require_adapters(config: Path, folder: Path) -> None:
    """Check that a configuration uses only device adapters from one folder.

    A configuration from elsewhere could run foreign code in two ways. Micro-Manager's core lets the
    operating system search for the library of an adapter, even in the folder of the spec. And some
    adapters execute a file whose name is the value of a property.

    Lines are split as Micro-Manager splits them: at commas, without empty fields, up to the first
    carriage return. Labels of a device's states, such as the objective "10x/0.25", are not taken
    for names of files.

    Raises:
        AbortError: If the configuration names an adapter that the folder lacks, or a file in
            another folder.
    """
    if not config.is_file() or config.stat().st_size > CONFIG_MAX:
        raise AbortError(
            f"{config}: the configuration must be a file of at most {CONFIG_MAX >> 20} MiB"
        )
    lines = config.read_bytes().decode(errors="replace").split("\n")
    for number, line in enumerate(lines, start=1):
        fields = [field for field in line.partition("\r")[0].split(",") if field]
        if line.startswith("#") or not fields:
            continue
        if fields[0] == "Device" and len(fields) > 2:
            is_name = re.fullmatch(r"[\w-]+", fields[2])
            if not is_name or not (folder / LIBRARY.format(fields[2])).is_file():
                text = f"{folder} does not contain the device adapter {fields[2]!r}"
                raise AbortError(f"{config}:{number}: {text}")
        elif fields[0] == "Label" or fields[-2:-1] == ["Label"]:
            del fields[-1]
        for field in filter(_PLACE.search, fields):
            text = f"{field!r} may name a file, which a device adapter would then run"
            raise AbortError(
                f"{config}:{number}: {text}",
                "save a configuration that contains only the camera, and no / or \\",
            )


class MicroManagerFeed(Feed):
    """A camera that is configured in Micro-Manager.

    An image has the upper eight bits of the camera's grey levels or, for a colour camera, the mean
    of red, green and blue. The constructor starts the acquisition.

    Args:
        source: The fields of the source in the spec.
        clock: The clock for times.
        timeout_s: Not used.

    Raises:
        AbortError: If pymmcore or Micro-Manager is missing, or the camera cannot be started.
    """

    def __init__(self, source: MicroManagerSource, clock: Clock, timeout_s: float) -> None:
        try:
            core = import_module("pymmcore").CMMCore
        except ModuleNotFoundError as error:
            raise AbortError(
                "a camera source of type micromanager needs pymmcore, which is not installed",
                "pip install './packages/tetractl-microscope[micro-manager]'",
            ) from error
        self._clock = clock
        self._closing = threading.Event()
        folder = adapter_folder()
        config = Path(source.config).resolve()
        require_adapters(config, folder)
        self._core: Any = core()
        try:
            # in an empty folder, since libraries and files of adapters may be searched in this one
            with TemporaryDirectory() as empty, chdir(empty):
                self._core.setDeviceAdapterSearchPaths([str(folder)])
                self._core.loadSystemConfiguration(str(config))
                self._shift = max(0, self._core.getImageBitDepth() - 8)
                self._core.startContinuousSequenceAcquisition(0.0)
        except FAILURES as error:
            self._core.reset()
            text = f"{config}: {' '.join(str(error).split())}"
            raise AbortError(
                text, "does Micro-Manager itself show live images from this camera?"
            ) from error

    def read(self) -> Picture:
        """Wait for the next image.

        Raises:
            SourceEndedError: If the camera fails, is closed, or delivers no image for 10 s.
        """
        silent = self._clock.now() + 10 * SECOND
        while not self._closing.is_set():
            try:
                if self._core.getRemainingImageCount():
                    pixels = self._core.popNextImage()
                    return Picture(self._grey(pixels), self._clock.now())
                running = self._core.isSequenceRunning()
            except FAILURES as error:
                raise SourceEndedError(f"Micro-Manager reports: {error}") from error
            if not running or self._clock.now() > silent:
                raise SourceEndedError("Micro-Manager's camera sends no more images")
            self._clock.sleep_until(self._clock.now() + SECOND // 500)
        raise SourceEndedError("Micro-Manager's camera was closed")

    def interrupt(self) -> None:
        """End a `read` that waits in another thread, within a few milliseconds."""
        self._closing.set()

    def close(self) -> None:
        """Stop the acquisition and release the camera, even if stopping fails."""
        try:
            self._core.stopSequenceAcquisition()
        finally:
            self._core.reset()

    def _grey(self, pixels: np.ndarray) -> np.ndarray:
        """Convert pixels to 8-bit grey levels.

        Grey pixels keep their upper bits. Pixels of 4 bytes become the mean of the first three.
        """
        if pixels.dtype.itemsize < 4:
            return np.minimum(pixels >> self._shift, 255).astype(np.uint8)
        colours = np.ascontiguousarray(pixels).view(np.uint8).reshape(*pixels.shape, 4)
        return colours[..., :3].mean(axis=-1).astype(np.uint8)
