"""Base class of cameras that send each frame as one message."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, Self

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.errors import AbortError, describe_error
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.lab.cameras.stamp_clock import StampClock
from tetractl.lab.serial_port import UNREADABLE, PortFactory, SerialPort
from tetractl.lab.udp_port import SCHEME, open_port
from tetractl.spec.section_abilities import Addressed
from tetractl.tools.worker import take_all

REQUEST = b"poses\n"
"""The message that requests the stream of poses. It is sent once, when the camera is opened."""
PENDING_FRAMES_MAX = 1000
"""Maximum number of frames that wait to be fetched. Beyond it, the oldest frames are dropped."""
PORT_BAUD = 115200
"""Speed of serial ports [bits per second]."""


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

    connect_s = 3.0
    """Maximum time to wait for the first frame [s]."""
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
        self._frame_count = 0  # number of frames so far
        self._pending_frames = deque[CameraFrame](maxlen=PENDING_FRAMES_MAX)
        self._stamps = StampClock()
        create_port = ports or (open_port if section.address.startswith(SCHEME) else self.port)
        self._port = create_port(
            section.address, PORT_BAUD, "the camera", clock, self._receive, self.hint
        )

    def port(self, *arguments: Any) -> SerialPort:
        """Create the port that receives the messages, with the arguments of `SerialPort`.

        By default, it is a serial port. At udp:// addresses, such as those of emulated cameras,
        this port is not used.
        """
        return SerialPort(*arguments)

    @abstractmethod
    def poses(self, message: bytes) -> tuple[Pose | None, ...]:
        """Decode a message to the poses of the setup's robots.

        If the message cannot be read, raise any of UNREADABLE, such as ValueError or KeyError. The
        message is then counted as damaged.

        Args:
            message: The received bytes of one message.

        Returns:
            The pose of each robot, in the setup's order. None if a robot is untracked.
        """

    def stamp_s(self, message: bytes) -> float | None:
        """Return when the image of a message was exposed, on the camera's own clock [s].

        The clock may have any zero. By default, the result is None, which means that the message
        does not contain this time. tetractl assumes that the fastest of the last 600 messages with
        stamps took `latency`. How much longer each other message took follows from its stamp and
        its arrival.
        """
        return None

    def __enter__(self) -> Self:
        """Open the port, request frames, and wait for the first frame.

        Raises:
            AbortError: If no frame arrives.
        """
        self._port.open()
        self._port.write(REQUEST)
        has_frame = wait_for(self._clock, lambda: self._frame_count > 0, self.connect_s)
        if not has_frame or self._port.failure:
            self._port.close()
            if self._first_damaged:
                problem = (
                    f"{self.damaged} messages came from the camera, but none could be "
                    "read; the first"
                )
                raise AbortError(
                    f"{problem}: {self._first_damaged}",
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
        return take_all(self._pending_frames)

    def _receive(self, data: bytes, received_ns: int) -> None:
        """Convert a message to a frame with the time of its exposure.

        Empty data mean that the port has failed: the frame then has a fault and no poses.
        """
        fault = "" if data else self._port.failure or "the camera's port has failed"
        n_robots = len(self.setup.names)
        try:
            poses = self.poses(data) if data else (None,) * n_robots
            stamp_s = self.stamp_s(data) if data else None
            if len(poses) != n_robots:
                raise ValueError(f"{len(poses)} poses, not {n_robots}")
        except UNREADABLE as error:
            self.damaged += 1
            self._first_damaged = (
                self._first_damaged or f"{describe_error(error)}, in {data[:60]!r}"
            )
            return
        late_ns = 0
        if stamp_s is not None:
            late_ns = self._stamps.measure_lateness_ns(round(stamp_s * SECOND), received_ns)
        exposed_ns = max(0, received_ns - round(self.section.latency * SECOND) - late_ns)
        self._frame_count += 1
        self._pending_frames.append(
            CameraFrame(self._frame_count, exposed_ns, received_ns, poses, fault=fault)
        )
        self._wake()
