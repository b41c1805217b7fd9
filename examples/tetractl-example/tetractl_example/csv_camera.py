"""`camera: {type: csv-camera}`: poses out of a CSV file, at the times that stand there.

The columns are time_s, robot, x, y, heading, in the spec's units; rows of one time are one frame,
and a robot without a row is not tracked in it. The last frame is repeated at the end.
"""

import csv
import threading
from collections import deque
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.spec.base import Positive
from tetractl.spec.lab_section import CameraSection

POSE = ("x", "y", "heading")
Frame = tuple[float, tuple[Pose | None, ...]]
"""Time [s] and the pose of each robot, None where it has no row."""


class CsvCameraSection(CameraSection):
    """Poses out of a CSV file: time_s, robot, x, y, heading."""

    type: Literal["csv-camera"]
    file: str
    """The file."""
    rate: Positive = 100.0
    """Frames a second after the last one of the file [Hz]."""

    def build(self, setup: Setup, clock: Clock, wake: Callable[[], None]) -> "CsvCamera":
        """Return the camera of the setup's robots, in their order."""
        return CsvCamera(self, setup.names, clock, wake)


class CsvCamera:
    """Frames from a file, each when it is due; a `Camera`."""

    damaged = 0

    def __init__(
        self,
        section: CsvCameraSection,
        names: tuple[str, ...],
        clock: Clock,
        wake: Callable[[], None],
    ) -> None:
        self._section, self._names, self._clock, self._wake = section, names, clock, wake
        self._fresh: deque[CameraFrame] = deque(maxlen=1000)
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        frames = read(Path(self._section.file), self._names)
        start_ns = self._clock.now()
        self._show(0, start_ns, frames[0][1])  # a camera that was entered has a frame
        self._thread = threading.Thread(target=self._play, args=(frames, start_ns), daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._closing.set()
        if self._thread is not None:
            self._thread.join()

    def check(self) -> Health:
        """Nothing can be wrong with a file that was read."""
        return Health(facts={"csv_file": self._section.file})

    def frames(self) -> list[CameraFrame]:
        """Return, once, every frame since the last call, oldest first."""
        return [self._fresh.popleft() for _ in range(len(self._fresh))]

    def _play(self, frames: list[Frame], start_ns: int) -> None:
        number = 0
        while not self._closing.is_set():
            number += 1
            past = max(0, number - len(frames) + 1)
            time_s, poses = frames[min(number, len(frames) - 1)]
            seconds = time_s - frames[0][0] + past / self._section.rate
            due_ns = start_ns + round(seconds * SECOND)
            self._clock.sleep_until(due_ns)
            self._show(number, due_ns, poses)

    def _show(self, number: int, due_ns: int, poses: tuple[Pose | None, ...]) -> None:
        self._fresh.append(CameraFrame(number, due_ns, self._clock.now(), poses))
        self._wake()


def read(path: Path, names: tuple[str, ...]) -> list[Frame]:
    """Return the frames of a file; AbortError where it is none of these."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [
                (float(row["time_s"]), row["robot"], Pose(*(float(row[name]) for name in POSE)))
                for row in csv.DictReader(file)
            ]
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise AbortError(f"{path}: cannot be read as camera frames: {error}") from error
    if not rows:
        raise AbortError(f"{path}: holds no frames")
    frames: list[Frame] = []
    for time_s, group in groupby(rows, key=lambda row: row[0]):
        seen = {name: pose for _, name, pose in group}
        frames.append((time_s, tuple(map(seen.get, names))))
    return frames
