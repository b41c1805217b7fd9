"""The base of cameras that send each frame as one message, once a program has asked for them."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Self

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.commands import Health
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab.serial_port import Ports

ASKED = b"poses\n"
WAITING_MAX = 1000  # frames


class PortCamera(ABC):
    """Frames of `count` robots from `address`, a port that `ports` makes; see
    `tetractl.core.protocols.Camera`.

    A frame was exposed `latency_s` [s] before its message came. If the port fails, the robots stop
    at once. Subclasses set `emulated` if a message says so.
    """

    connect_s = 3.0  # longest wait for the first frame
    hint = "does the camera's program run, at this address?"

    def __init__(
        self,
        count: int,
        address: str,
        latency_s: float,
        clock: Clock,
        wake: Callable[[], None],
        ports: Ports,
    ) -> None:
        self.damaged, self.emulated, self._none = 0, False, (None,) * count
        self._clock, self._wake, self._late_ns = clock, wake, round(latency_s * SECOND)
        self._fresh, self._number = deque[CameraFrame](maxlen=WAITING_MAX), 0
        self._port = ports(address, 0, "the camera", clock, self._heard, self.hint)

    @abstractmethod
    def poses(self, message: bytes) -> tuple[Pose | None, ...]:
        """Return the pose of each robot of the setup, None if it is not tracked.

        Raises ValueError, KeyError, TypeError or IndexError if the message cannot be read.
        """

    def __enter__(self) -> Self:
        """Ask for frames; return once one has come. AbortError if none comes."""
        self._port.open()
        self._port.write(ASKED)
        came = wait_for(self._clock, lambda: bool(self._number), self.connect_s)
        if not came or self._port.failure:
            self._port.close()
            raise AbortError(self._port.failure or "no camera frame came", self.hint)
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def check(self) -> Health:
        """Return whether the camera is emulated."""
        return Health(emulated=self.emulated)

    def frames(self) -> list[CameraFrame]:
        """Return every frame since the last call, oldest first."""
        return [self._fresh.popleft() for _ in range(len(self._fresh))]

    def _heard(self, data: bytes, at_ns: int) -> None:
        """Take a message; without data, the port has failed."""
        fault = "" if data else self._port.failure or "the camera's port has failed"
        try:
            poses = self.poses(data) if data else self._none
        except (ValueError, KeyError, TypeError, IndexError):
            self.damaged += 1
            return
        self._number += 1
        shot_ns = max(0, at_ns - self._late_ns)
        self._fresh.append(CameraFrame(self._number, shot_ns, at_ns, poses, fault=fault))
        self._wake()
