"""Reads images from a microscope's camera through Micro-Manager's core, `pymmcore`.

This module was not tested with a real camera. According to its documentation, the core fills a
circular buffer while a sequence of images is taken. This feed removes each image at once, so that
no image waits in the buffer. `PictureCamera` skips and counts the images for which its search is
too slow.
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

FOLDER_VARIABLE = "MICROMANAGER_PATH"
"""Environment variable that names the folder where Micro-Manager is installed."""
DEFAULT_FOLDERS = {  # where Micro-Manager is installed by default, by platform
    "win32": "C:/Program Files/Micro-Manager-2.0",
    "darwin": "/Applications/Micro-Manager",
    "linux": "/usr/local/lib/micro-manager",
}
CONFIG_MAX_BYTES = 1 << 24  # maximum size of a configuration file [bytes]
LIBRARY_NAME = {"win32": "mmgr_dal_{}.dll", "darwin": "libmmgr_dal_{}"}.get(
    sys.platform, "libmmgr_dal_{}.so.0"
)
"""Template for the file name of a device adapter's library, as Micro-Manager's core builds it."""
CORE_ERRORS = (OSError, RuntimeError, ValueError)  # the exceptions that pymmcore raises
_PATH_PATTERN = re.compile(r"[/\\]|^\.\.$")  # a field that could name a file


def find_adapter_folder() -> Path:
    """Find the folder of Micro-Manager's device adapters, the libraries that drive its cameras.

    The environment variable MICROMANAGER_PATH names the folder. Otherwise, the default folder of
    the platform is used. A spec cannot name the folder, because the libraries in it are executed.

    Raises:
        AbortError: If Micro-Manager is not installed.
    """
    folder = Path(
        os.environ.get(FOLDER_VARIABLE)
        or DEFAULT_FOLDERS.get(sys.platform, DEFAULT_FOLDERS["linux"])
    )
    if not folder.is_dir():
        hint = f"tell tetractl the folder of Micro-Manager: {FOLDER_VARIABLE}=FOLDER tetractl ..."
        raise AbortError(f"Micro-Manager is not installed in {folder}", hint)
    return folder.resolve()


def require_adapters(config: Path, folder: Path) -> None:
    """Check that a Micro-Manager configuration uses only device adapters from one folder.

    Otherwise, a configuration from somebody else could run foreign code in two ways.
    Micro-Manager's core lets the operating system search for the library of an adapter, even in the
    folder of the spec. And some adapters execute a file whose name is the value of a property.

    Lines are split as Micro-Manager splits them: at commas, without empty fields, up to the first
    carriage return. The label of a device's state, such as the objective "10x/0.25", may contain a
    slash.

    Args:
        config: The configuration file.
        folder: The folder that contains the libraries of the device adapters.

    Raises:
        AbortError: If the configuration is not a file or too large, if it names an adapter that the
            folder lacks, or if a field could name a file.
    """
    if not config.is_file() or config.stat().st_size > CONFIG_MAX_BYTES:
        raise AbortError(
            f"{config}: the configuration must be a file of at most {CONFIG_MAX_BYTES >> 20} MiB"
        )
    lines = config.read_bytes().decode(errors="replace").split("\n")
    for number, line in enumerate(lines, start=1):
        fields = [field for field in line.partition("\r")[0].split(",") if field]
        if line.startswith("#") or not fields:
            continue
        if fields[0] == "Device" and len(fields) > 2:
            name_match = re.fullmatch(r"[\w-]+", fields[2])
            if not name_match or not (folder / LIBRARY_NAME.format(fields[2])).is_file():
                problem = f"{folder} does not contain the device adapter {fields[2]!r}"
                raise AbortError(f"{config}:{number}: {problem}")
        elif fields[0] == "Label" or fields[-2:-1] == ["Label"]:
            del fields[-1]
        for field in filter(_PATH_PATTERN.search, fields):
            problem = f"{field!r} may name a file, which a device adapter would then run"
            raise AbortError(
                f"{config}:{number}: {problem}",
                "save a configuration that contains only the camera, and no / or \\",
            )


class MicroManagerFeed(Feed):
    """The images of a camera that is configured in Micro-Manager.

    Images have 8-bit grey levels: the upper eight bits of a grey camera, or the mean of red, green
    and blue of a colour camera. The constructor starts the acquisition.

    Args:
        source: The fields of the source in the spec.
        clock: The clock that gives the time at which an image is received.
        timeout_s: Not used. Every feed has this parameter.

    Raises:
        AbortError: If pymmcore or Micro-Manager is missing, or the camera cannot be started.
    """

    def __init__(self, source: MicroManagerSource, clock: Clock, timeout_s: float) -> None:
        try:
            create_core = import_module("pymmcore").CMMCore
        except ModuleNotFoundError as error:
            raise AbortError(
                "a camera source of type micromanager needs pymmcore, which is not installed",
                "pip install './packages/tetractl-microscope[micro-manager]'",
            ) from error
        self._clock = clock
        self._closing = threading.Event()
        folder = find_adapter_folder()
        config = Path(source.config).resolve()
        require_adapters(config, folder)
        self._core: Any = create_core()
        try:
            # in an empty folder, because the core may search the working directory for libraries
            with TemporaryDirectory() as empty_folder, chdir(empty_folder):
                self._core.setDeviceAdapterSearchPaths([str(folder)])
                self._core.loadSystemConfiguration(str(config))
                self._grey_shift_bits = max(0, self._core.getImageBitDepth() - 8)
                self._core.startContinuousSequenceAcquisition(0.0)
        except CORE_ERRORS as error:
            self._core.reset()
            problem = f"{config}: {' '.join(str(error).split())}"
            raise AbortError(
                problem, "does Micro-Manager itself show live images from this camera?"
            ) from error

    def read(self) -> Picture:
        """Wait for the next image.

        Raises:
            SourceEndedError: If the camera fails, is closed, or delivers no image for 10 s.
        """
        deadline_ns = self._clock.now() + 10 * SECOND
        while not self._closing.is_set():
            try:
                if self._core.getRemainingImageCount():
                    pixels = self._core.popNextImage()
                    return Picture(self._convert_to_grey(pixels), self._clock.now())
                is_running = self._core.isSequenceRunning()
            except CORE_ERRORS as error:
                raise SourceEndedError(f"Micro-Manager reports: {error}") from error
            if not is_running or self._clock.now() > deadline_ns:
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

    def _convert_to_grey(self, pixels: np.ndarray) -> np.ndarray:
        """Convert the pixels of a camera to 8-bit grey levels.

        Grey pixels keep their upper bits. A colour pixel of 4 bytes becomes the mean of its first
        three bytes.
        """
        if pixels.dtype.itemsize < 4:
            return np.minimum(pixels >> self._grey_shift_bits, 255).astype(np.uint8)
        colours = np.ascontiguousarray(pixels).view(np.uint8).reshape(*pixels.shape, 4)
        return colours[..., :3].mean(axis=-1).astype(np.uint8)
