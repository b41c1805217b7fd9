"""Receive robots' poses from OptiTrack cameras over the network.

The class implements the protocol `Camera`. It requests the names of bodies (MODELDEF), the frames
and the clock from the server when they are due, and checks the connection before a run. The
receiver's thread continues after any bad datagram or socket error. It counts bad datagrams, and
stores the last socket error in `error`. It never waits for somebody to fetch its frames.
"""

import select
import socket
import struct
import sys
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import Any, Self

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame
from tetractl.core.protocols import EMULATED_NAME, Health
from tetractl.core.setup import Setup
from tetractl.lab.cameras.optitrack import diagnosis, natnet
from tetractl.lab.cameras.optitrack.natnet import Placement, UpAxis
from tetractl.lab.cameras.optitrack.section import OptitrackSection
from tetractl.lab.cameras.optitrack.sender_filter import SenderFilter
from tetractl.lab.cameras.optitrack.stream import UNITS_SETTING, UP_AXIS_SETTING, NatNetStream
from tetractl.lab.cameras.optitrack.wire import DATAGRAM_MAX, pack_message
from tetractl.spec.lab_section import entry
from tetractl.tools.worker import QUEUE_MAX, take_all

REQUEST_INTERVAL_NS = SECOND // 4
"""Time after which an unanswered request is repeated [ns]."""
INITIAL_ECHOES = 20
"""Number of echoes that are requested quickly at first, so that the clock is known early."""
SELECT_TIMEOUT_S = (
    0.02  # longest wait for a datagram, after which a request to close is noticed [s]
)


class OptitrackCamera:
    """Tracks robots by their rigid bodies in OptiTrack; see `tetractl.core.protocols.Camera`.

    Args:
        section: The fields of the camera in the spec.
        setup: The constants of the experiment.
        clock: The clock for times [ns].
        wake: Called in the receiver's thread after every new frame.
        make_socket: Creates a UDP socket in memory, which calls its argument instead of using a
            thread. None for sockets of this computer.
    """

    def __init__(
        self,
        section: OptitrackSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
        make_socket: Callable[[Callable[[], None]], Any] | None = None,
    ) -> None:
        self.names = setup.names
        robots = [entry(section.robots, name) for name in setup.names]
        self.section = section
        self.error: OSError | None = None
        self.senders = SenderFilter(section.server, section.command_port)
        self._clock = clock
        self._wake = wake
        self._threaded = make_socket is None
        self._make_socket = make_socket or (
            lambda turn: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        )
        self._unicast = section.transport == "unicast"
        self._requested_version = (
            natnet.Version.parse(section.version) if section.version and self._unicast else None
        )
        up = {"auto": None, "y": UpAxis.Y, "z": UpAxis.Z}[section.up_axis]
        placement = Placement(*section.origin, section.rotation, 1.0 / setup.metres)
        self.stream = NatNetStream(robots, placement, self._requested_version, up)
        self._new_frames: deque[CameraFrame] = deque(maxlen=QUEUE_MAX)
        self._closing = threading.Event()
        self._sockets: list[socket.socket] = []
        self._due_ns_by_request: dict[str, int] = {}
        self._request_counts: Counter[str] = Counter()
        self._next_request_ns = 0  # when a request is due again, if nothing comes
        self._thread = threading.Thread(target=self._receive, name="natnet", daemon=True)

    @property
    def damaged(self) -> int:
        """Number of datagrams so far that could not be read."""
        return self.stream.counts.unread

    def __enter__(self) -> Self:
        """Connect, and wait until frames arrive and the server's clock, axes and names are known.

        Raises:
            AbortError: If something is missing. The error says what is missing, what was received
                instead, and which setting to change.
        """
        try:
            self.open()
            self.wait_connected(self.section.connect)
        except BaseException:
            self.__exit__()
            raise
        return self

    def open(self) -> None:
        """Open the network sockets, and start the requests and the reception of frames.

        Raises:
            AbortError: If the sockets cannot be opened.
        """
        try:
            self._open_sockets()
        except OSError as error:
            raise AbortError(
                f"cannot receive camera frames on the address {self.section.interface}: "
                f"{error.strerror or error}",
                "set lab.camera.interface to an address of this computer",
            ) from error
        if self._threaded:
            self._thread.start()

    def turn(self) -> None:
        """Send the due requests, and read the datagrams that have arrived, without waiting.

        This method is for cameras without a thread, which use sockets in memory. If the camera is
        not open, nothing happens.
        """
        if self._sockets:
            self._send_due_requests()
        for endpoint in self._sockets:
            self._read(endpoint)

    def wait_connected(self, timeout_s: float) -> None:
        """Wait for frames, clock, axes and names, for at most `timeout_s` each.

        Raises:
            AbortError: If the server, its frames, a usable up axis, or names that the spec needs
                are missing, if the server's protocol is too old, or if frames cease to come. A
                missing clock is no error.
        """
        stream = self.stream
        if not self._wait(lambda: stream.info is not None, timeout_s):
            raise diagnosis.create_no_server_error(self.section, self.senders, timeout_s)
        if stream.version is not None and stream.version < natnet.OLDEST:
            raise AbortError(
                f"the camera server uses protocol {stream.version}, whose frames do not say "
                "which bodies are tracked: a lost robot would look like a robot that stands "
                "still",
                f"update Motive to a version that has NatNet {natnet.OLDEST} or later (Motive 1.7)",
            )
        if not self._wait(lambda: stream.newest is not None, timeout_s):
            raise diagnosis.create_no_frames_error(self.section, self.senders, stream, timeout_s)
        self._wait(lambda: stream.model is not None and stream.up_axis is not None, timeout_s)
        if stream.up_axis is None:
            raise diagnosis.create_up_axis_error(stream)
        if stream.model is None and any(isinstance(robot.body, str) for robot in stream.robots):
            raise diagnosis.create_names_error(stream, timeout_s)
        if self.stream.clock_sync is not None:
            self._wait(lambda: self._request_counts["echo"] >= INITIAL_ECHOES, timeout_s)
        frames_before = self.stream.counts.frames
        if not self._wait(lambda: self.stream.counts.frames > frames_before, timeout_s):
            raise AbortError(f"the camera server has sent no new frames for {timeout_s:g} s")

    def frames(self) -> list[CameraFrame]:
        """Return the frames received since the last call, oldest first."""
        return take_all(self._new_frames)

    def __exit__(self, *_: object) -> None:
        """Disconnect and end the receiver's thread.

        This method can be called twice, and never raises.
        """
        if self._sockets and not self._closing.is_set():
            self._send(natnet.BareMessage(natnet.MessageKind.DISCONNECT))
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
        for endpoint in self._sockets:
            endpoint.close()
        self._sockets = []

    def check(self) -> Health:
        """Check the stream, for example whether all bodies are streamed; see `Device.check`."""
        stream = self.stream
        sync = self.stream.clock_sync
        problems = diagnosis.describe_missing_bodies(stream, self.names)
        warnings = diagnosis.describe_dropped_datagrams(self.senders, stream)
        round_trip = "unknown"
        if sync is not None and sync.is_synced:
            round_trip = f"{sync.round_trip_ns / 1e6:.3f}"
        else:
            warnings.append(
                "the server does not report its clock, so the age of its frames is unknown"
            )
        if stream.unit_mm is None:
            warnings.append("the server does not report its unit of length, so metres are assumed")
        version = stream.version
        if version is not None and not version.known:
            warnings.append(
                f"the server's protocol {version} is newer than 4.3; its frames "
                "are read as protocol 4.3"
            )
        server = stream.info.name if stream.info else ""
        facts = {
            "natnet": str(version),
            "server": server,
            "rigid_bodies": diagnosis.list_bodies(stream),
            "clock_round_trip_ms": round_trip,
        }
        return Health(tuple(problems), tuple(warnings), facts, emulated=EMULATED_NAME in server)

    def _open_sockets(self) -> None:
        """Open a socket for commands and, in multicast, another one for frames."""
        section = self.section
        command_socket = self._make_socket(self.turn)
        self._sockets.append(command_socket)
        command_socket.bind((section.interface, 0))
        if not self._unicast:
            data_socket = self._make_socket(self.turn)
            self._sockets.append(data_socket)
            data_socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            # on Linux, a socket bound to the group receives only that; other systems refuse it
            data_socket.bind((section.group if sys.platform == "linux" else "", section.data_port))
            membership = struct.pack(
                "4s4s", socket.inet_aton(section.group), socket.inet_aton(section.interface)
            )
            data_socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        for endpoint in self._sockets:
            endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 18)
            endpoint.setblocking(False)

    def _receive(self) -> None:
        """Send requests and read datagrams until the camera is closed, in a thread of its own."""
        while not self._closing.is_set():
            try:
                self._send_due_requests()
                readable_sockets, _, _ = select.select(self._sockets, [], [], SELECT_TIMEOUT_S)
                for endpoint in readable_sockets:
                    self._read(endpoint)
            except (OSError, ValueError) as error:
                if self._closing.is_set():
                    return
                self.error = error if isinstance(error, OSError) else OSError(str(error))
                self._closing.wait(SELECT_TIMEOUT_S)  # a network card that went down may come back

    def _read(self, udp_socket: socket.socket) -> None:
        while True:
            try:
                datagram, (host, port) = udp_socket.recvfrom(DATAGRAM_MAX)
            except BlockingIOError:
                return
            except ConnectionError:  # an ICMP "port unreachable" in answer to an earlier message
                continue
            if not self.senders.accept(datagram, host, port):
                continue
            previous = self.stream.newest
            message = self.stream.feed(datagram, self._clock.now())
            newest = self.stream.newest
            self._next_request_ns = 0
            if newest is not None and newest is not previous:
                self._new_frames.append(newest)
                self.error = None
                self._wake()
            if isinstance(message, natnet.NatNetFrame):
                self.senders.fix_frames_port(port)
            elif isinstance(message, natnet.ServerInfo) and self._unicast:
                self.senders.fix_frames_port(message.data_port)

    def _send_due_requests(self) -> None:
        """Send the requests to the camera's server that are due now."""
        now_ns = self._clock.now()
        if now_ns < self._next_request_ns:
            return
        requests = list(self._list_requests(now_ns))
        for name, period_ns, message in requests:
            if now_ns >= self._due_ns_by_request.get(name, now_ns):
                self._due_ns_by_request[name] = now_ns + period_ns
                self._request_counts[name] += 1
                self.stream.record_request(message)
                self._send(message)
        self._next_request_ns = min(
            (self._due_ns_by_request[name] for name, _, _ in requests), default=0
        )

    def _list_requests(self, now_ns: int) -> Iterator[tuple[str, int, natnet.ClientMessage]]:
        """Yield the requests to send at present: name, interval until it is repeated [ns], message.

        The requests ask for missing information and for the server's time. In unicast, they also
        keep the stream running. Once names are known, the interval between requests for models
        doubles each time, up to 8 s, because some servers report a change in every frame.
        """
        stream = self.stream
        requested_version = self._requested_version
        if stream.info is None:
            yield (
                "connect",
                REQUEST_INTERVAL_NS,
                natnet.Connect(requested_version or natnet.NEWEST, requested_version is not None),
            )
            return
        if stream.up_axis is None:
            yield "up", REQUEST_INTERVAL_NS, natnet.NatNetRequest(UP_AXIS_SETTING)
        elif stream.unit_mm is None and self._request_counts["unit"] < 4:  # some servers ignore it
            yield "unit", REQUEST_INTERVAL_NS, natnet.NatNetRequest(UNITS_SETTING)
        if stream.model is None:
            yield (
                "models",
                REQUEST_INTERVAL_NS,
                natnet.BareMessage(natnet.MessageKind.REQUEST_MODELDEF),
            )
        elif stream.models_changed or stream.is_changing or stream.list_missing_bodies():
            wait_ns = REQUEST_INTERVAL_NS << min(self._request_counts["models"], 5)
            yield "models", wait_ns, natnet.BareMessage(natnet.MessageKind.REQUEST_MODELDEF)
        else:
            self._request_counts["models"] = 0
            self._due_ns_by_request["models"] = min(
                self._due_ns_by_request.get("models", now_ns), now_ns + REQUEST_INTERVAL_NS
            )
        if self._unicast:
            yield "alive", SECOND, natnet.BareMessage(natnet.MessageKind.KEEPALIVE)
        if stream.clock_sync is not None:
            is_initial = self._request_counts["echo"] < INITIAL_ECHOES
            yield "echo", SECOND // 50 if is_initial else SECOND // 2, natnet.EchoRequest(now_ns)

    def _send(self, message: natnet.ClientMessage) -> None:
        """Send a message to the server. A socket error is only stored."""
        data = pack_message(message)
        try:
            self._sockets[0].sendto(data, (self.section.server, self.section.command_port))
        except OSError as error:
            self.error = error

    def _wait(self, is_done: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until a condition holds, for at most `timeout_s` seconds. Return whether it does."""
        return wait_for(self._clock, is_done, timeout_s)
