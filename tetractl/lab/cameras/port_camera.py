"""Base class of cameras that send each frame as one message."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, Self

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.errors import AbortError, text_of
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.lab.cameras.stamp_clock import StampClock
from tetractl.lab.serial_port import UNREADABLE, PortFactory, SerialPort
from tetractl.lab.udp_port import SCHEME, open_port
from tetractl.spec.section_abilities import Addressed
from tetractl.tools.worker import drained

ASKED = b"poses\n"
FRAMES_WAITING_MAX = 1000  # frames
PORT_BAUD = 115200  # of serial ports


class PortCamera(ABC):
    """Base class of a camera that sends each frame as one message to an address in the spec.

    A frame was exposed the section's `latency` [s] before its message arrived, unless messages have
    stamps (`stamp_s`). If the port fails, the robots stop at once. A subclass sets `emulated` once
    a message reports that the camera is emulated.

    Args:
        section: The fields of the camera in the spec.
        setup: The constants of the experiment.
        clock: The clock for times [ns].
        wake: Called after every new frame.
        ports: Creates the port, such as one in memory. None for a port of this computer.
    """

    connect_s = 3.0  # longest wait for the first frame
    hint = "does the camera's program run, and does it use this address?"
    emulated = False

    def __init__(
        self,
        section: Addressed,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
        ports: PortFactory | None = None,
    ) -> None:
        self.section = section
        self.setup = setup
        self.damaged = 0
        self._first_damaged = ""  # why the first damaged message could not be read
        self._clock = clock
        self._wake = wake
        self._came = 0  # number of frames so far
        self._waiting = deque[CameraFrame](maxlen=FRAMES_WAITING_MAX)
        self._stamps = StampClock()
        make = ports or (open_port if section.address.startswith(SCHEME) else self.port)
        self._port = make(section.address, PORT_BAUD, "the camera", clock, self._receive, self.hint)

    def port(self, *arguments: Any) -> SerialPort:
        """Create the port that receives the messages, with the arguments of `SerialPort`.

        By default, it is a serial port. At udp:// addresses, such as those of emulated cameras,
        this port is not used.
        """
        return SerialPort(*arguments)

    @abstractmethod
    def poses(self, message: bytes) -> tuple[Pose | None, ...]:
        """Decode a message to the pose of each robot of the setup. None if one is untracked.

        Raise any of UNREADABLE, such as ValueError or KeyError, if the message cannot be read. The
        message is then counted as damaged.
        """

    def stamp_s(self, message: bytes) -> float | None:
        """Return when a message's image was exposed, on the camera's own clock with any zero [s].

        None, the default, if the message does not say so. The fastest of the last 600 messages with
        stamps is assumed to have taken `latency`. How much longer each other message took follows
        from its stamp and its arrival.
        """
        return None

    def __enter__(self) -> Self:
        """Open the port, request frames, and return once one has arrived.

        Raises:
            AbortError: If none arrives.
        """
        self._port.open()
        self._port.write(ASKED)
        came = wait_for(self._clock, lambda: self._came > 0, self.connect_s)
        if not came or self._port.failure:
            self._port.close()
            if self._first_damaged:
                many = (
                    f"{self.damaged} messages came from the camera, but none could be "
                    "read; the first"
                )
                raise AbortError(
                    f"{many}: {self._first_damaged}",
                    "check that the method `poses` reads the format in which the camera sends its "
                    "messages",
                )
            raise AbortError(self._port.failure or "no camera frame came", self.hint)
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def check(self) -> Health:
        """Report whether the camera is emulated by software. Nothing else is checked."""
        return Health(emulated=self.emulated)

    def frames(self) -> list[CameraFrame]:
        """Return every frame received since the last call, oldest first."""
        return drained(self._waiting)

    def _receive(self, data: bytes, at_ns: int) -> None:
        """Convert a message to a frame with the time of its exposure.

        Empty data mean that the port has failed: the frame then has a fault and no poses.
        """
        fault = "" if data else self._port.failure or "the camera's port has failed"
        robots = len(self.setup.names)
        try:
            poses = self.poses(data) if data else (None,) * robots
            stamp_s = self.stamp_s(data) if data else None
            if len(poses) != robots:
                raise ValueError(f"{len(poses)} poses, not {robots}")
        except UNREADABLE as error:
            self.damaged += 1
            self._first_damaged = self._first_damaged or f"{text_of(error)}, in {data[:60]!r}"
            return
        late_ns = 0
        if stamp_s is not None:
            late_ns = self._stamps.late_ns(round(stamp_s * SECOND), at_ns)
        exposed_ns = max(0, at_ns - round(self.section.latency * SECOND) - late_ns)
        self._came += 1
        self._waiting.append(CameraFrame(self._came, exposed_ns, at_ns, poses, fault=fault))
        self._wake()
