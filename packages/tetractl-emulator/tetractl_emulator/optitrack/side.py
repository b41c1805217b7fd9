"""The emulated camera of type `optitrack`: a Motive server.

It sends frames of rigid bodies by the NatNet protocol over UDP, unicast or multicast.
"""

import random
import socket
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

from tetractl.core.clock import SECOND
from tetractl.core.errors import WireError
from tetractl.core.protocols import EMULATED_NAME
from tetractl.core.setup import Setup
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.natnet import UpAxis
from tetractl.lab.cameras.optitrack.section import OptitrackSection
from tetractl.spec.base import Model
from tetractl.spec.lab_section import LabSection, entry
from tetractl_emulator.fault_rows import length_scale
from tetractl_emulator.faults import ActingFaults, Fault
from tetractl_emulator.loop import Loop
from tetractl_emulator.optitrack.natnet_server import mangle, pack_answer, parse_request
from tetractl_emulator.optitrack.pose_camera import PoseCamera, noise_of_day
from tetractl_emulator.optitrack.scripted import (
    CLOCK_HZ,
    CLOCK_START,
    FAULTS,
    OptitrackSettings,
    TrueBody,
)
from tetractl_emulator.optitrack.tracked_body import Asset, PoseNoise, TrackedBody, View
from tetractl_emulator.sides import Body, Facts, Options, Stage

Address = tuple[str, int]
RECORDED_COUNTS = ("frames", "refused", "timed_out")
"""Names of the counts in the record of an emulation.

They count frames sent, requests that could not be decoded, and silent clients that were dropped.
"""


@dataclass(slots=True)
class Client:
    """A unicast client of the server.

    Attributes:
        version: Version of the protocol in which the server sends to this client.
        received_ns: When the server last received a message from the client [ns].
    """

    version: natnet.Version
    received_ns: int


class ServerPorts:
    """The two UDP sockets of the server: one for commands and one for frames.

    Attributes:
        address: IP address of the server.
        command_port: Port at which the server receives commands.
        data_port: Port from which frames are sent. In multicast, the port to which they are sent.
        command: Socket for commands. None before `open`.
        data: Socket for frames. None before `open`.
    """

    def __init__(self, section: OptitrackSection, options: Options) -> None:
        self.address = options.address or section.server
        self.command_port = section.command_port
        self.data_port = section.data_port
        if options.command_port is not None:
            self.command_port = options.command_port
        if options.data_port is not None:
            self.data_port = options.data_port
        self.command: Any = None
        self.data: Any = None

    def open(self, bound: Callable[[str, int], Any], sender: str, multicast: bool) -> None:
        """Open both sockets.

        A port of 0 is replaced by the free port that the system has chosen. In multicast, a
        `data_port` other than 0 remains the port to which frames are sent. An error that `bound`
        raises, for example because a port is in use, is passed on. Call `close` then, because the
        first socket may be open.

        Args:
            bound: Creates a socket that is bound to an address and port.
            sender: Address from which frames are sent.
            multicast: Whether frames are sent by multicast, on the interface of `address`.
        """
        self.command = bound(self.address, self.command_port)
        self.command_port = _port_of(self.command)
        self.data = bound(sender, 0 if multicast else self.data_port)
        if multicast:
            interface = socket.inet_aton(self.address)
            self.data.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
        if not (multicast and self.data_port):
            # in multicast too, since no other server uses this port
            self.data_port = _port_of(self.data)

    def close(self) -> None:
        """Close both sockets if they are open. This method can be called repeatedly."""
        for opened in (self.command, self.data):
            if opened is not None:
                opened.close()


class EmulatedOptitrack(PoseCamera):
    """An emulated Motive server that streams a rigid body for each robot.

    Args:
        stage: The data and functions that the lab's emulated devices share.
        settings: The settings of the server.
        bodies: The bodies that carry markers.

    Attributes:
        names: Name and id of each rigid body that the server can describe to its clients.
        clients: The unicast clients that receive frames, by address.
        known_clients: Addresses of all clients that have ever connected.
        counts: Number of frames sent ("frames"), of requests that could not be decoded ("refused"),
            of silent clients that were dropped ("timed_out"), and of requests for the model
            definitions ("models asked").
        clock_errors: Functions from host time [ns] to the error of the server's clock [ns] at that
            time. The errors add up. Faults add functions to this list.
    """

    Settings: ClassVar[type[Model]] = OptitrackSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS

    @classmethod
    def world_of_day(cls, chance: random.Random, lab: LabSection, setup: Setup) -> dict[str, Any]:
        """Sample the camera's noise for a randomised test run; see `tetractl_emulator.sides`.

        Returns:
            Values for the camera's section of a script's `emulation`, by name.
        """
        return noise_of_day(chance, length_scale(lab, setup))

    def __init__(self, stage: Stage, settings: OptitrackSettings, bodies: Sequence[Body]) -> None:
        section = stage.lab.camera
        options = stage.options
        assert isinstance(section, OptitrackSection), "the camera's section has the type optitrack"
        tracked = _create_bodies(
            section, settings, bodies, random.Random(options.seed), stage.acting
        )
        self.names = tuple((body.asset.name, body.asset.number) for body in tracked)
        x, y = section.origin
        up = UpAxis.Z if section.up_axis == "z" else UpAxis.Y
        view = View(up, (x * stage.mm, y * stage.mm), section.rotation)
        super().__init__(stage, tracked, settings.rate, settings.latency, view)
        self.section = section
        self.settings = settings
        self.multicast = section.transport == "multicast"
        self.own_version = natnet.Version.parse(settings.version)
        self.ports = ServerPorts(section, options)
        self.clock_errors: list[Callable[[int], int]] = []
        self.clients: dict[Address, Client] = {}
        self.known_clients: set[Address] = set()
        self.counts = Counter[str]()

    @property
    def join(self) -> Any:
        """Factory that connects tetractl's camera to this server, by UDP sockets or in memory."""
        return self._stage.wires.make_socket

    def open(self, loop: Loop) -> Facts:
        """Open the UDP sockets and start to stream frames.

        Returns:
            The connection as a mapping: "camera" (for display), "address", "command_port",
            "data_port" and "transport".
        """
        ports = self.ports
        sender = self.settings.frames_from or ports.address
        ports.open(self._stage.wires.bound, sender, self.multicast)
        self.begin()
        loop.watch(ports.command.fileno(), lambda: self._read_commands(loop.catch_up))
        transport = self.section.transport
        return {
            "camera": f"{ports.address}:{ports.command_port} ({transport})",
            "address": ports.address,
            "command_port": ports.command_port,
            "data_port": ports.data_port,
            "transport": transport,
        }

    def close(self) -> Facts:
        """Close the UDP sockets.

        Returns:
            The counts that are named in RECORDED_COUNTS, by name.
        """
        self.ports.close()
        return {name: self.counts[name] for name in RECORDED_COUNTS}

    def ticks(self, when_ns: int) -> int:
        """Convert a time on the host's clock [ns] to a time on the server's clock [ticks].

        Acting faults of the clock are included.
        """
        gained_ns = sum(gained_ns(when_ns) for gained_ns in self.clock_errors)
        gained_ns += sum(round(jump.by * SECOND) for jump in self.acting.of_kind("clock_jump"))
        return CLOCK_START + (when_ns + gained_ns) * CLOCK_HZ // SECOND

    def _read_commands(self, catch_up: Callable[[], None]) -> None:
        """Answer the messages that wait at the command port.

        Args:
            catch_up: Advances the emulation's timeline to the present. Called before each answer.
        """
        for _ in range(100):
            try:
                datagram, sender = self.ports.command.recvfrom(65_535)
            except BlockingIOError:
                return
            except OSError:  # a client has gone: its host answered port unreachable
                continue
            if self.acting.of_kind("no_server"):
                continue
            catch_up()  # otherwise an echo could report a time before its request
            try:
                message = parse_request(datagram)
            except WireError:
                self.counts["refused"] += 1
                continue
            answer = self._create_answer(message, sender, self.timeline.now_ns)
            if answer is not None:
                client = self.clients.get(sender)
                version = client.version if client else self.own_version
                self._send(self.ports.command, pack_answer(answer, version), sender)

    def _create_answer(
        self, message: natnet.ClientMessage, sender: Address, now_ns: int
    ) -> natnet.ServerMessage | None:
        """Create the answer to a client's message. The result is None if there is no answer.

        A disconnect ends the client's registration. Any other message renews the registration.
        """
        if sender in self.clients:
            self.clients[sender].received_ns = now_ns
        match message:
            case natnet.Connect():
                self._register_client(message, sender, now_ns)
                name = f"Motive ({EMULATED_NAME})"
                return natnet.ServerInfo(name, self.own_version, CLOCK_HZ, self.ports.data_port)
            case natnet.EchoRequest(client):
                return natnet.EchoResponse(client, self.ticks(now_ns))
            case natnet.NatNetRequest("UnitsToMillimeters"):
                return natnet.Response(struct.pack("<f", self.settings.unit_mm))
            case natnet.NatNetRequest("UpAxis") if self.settings.knows_up_axis:
                return natnet.Response(struct.pack("<i", self.view.up))
            case natnet.NatNetRequest():
                return natnet.BareMessage(natnet.MessageKind.UNRECOGNIZED)
            case natnet.BareMessage(natnet.MessageKind.REQUEST_MODELDEF):
                self.counts["models asked"] += 1
                return natnet.ModelDef(self.names) if self.settings.answers_models else None
            case natnet.BareMessage(natnet.MessageKind.DISCONNECT):
                self.clients.pop(sender, None)
        return None

    def _register_client(self, message: natnet.Connect, sender: Address, now_ns: int) -> None:
        """Register a client. In multicast, only the client's first contact is recorded.

        With NatNet 4.0 or later, a unicast client can choose a version that is not newer than the
        server's version.
        """
        if sender not in self.known_clients:
            self.known_clients.add(sender)
            self._stage.client(f"{sender[0]}:{sender[1]}")
        if self.multicast:
            return
        version = message.version
        own_version = self.own_version
        is_version_chosen = message.pinned and not self.settings.keeps_version
        is_version_chosen = is_version_chosen and (4, 0) <= own_version >= version and version.known
        self.clients[sender] = Client(version if is_version_chosen else own_version, now_ns)

    def _receivers(self, now_ns: int) -> Iterator[tuple[Address, natnet.Version]]:
        """Yield each address to which frames are sent, with the version of the protocol to use.

        Unicast clients that have been silent for more than 5 s are dropped.
        """
        if self.multicast:
            yield (self.section.group, self.ports.data_port), self.own_version
        for address, client in list(self.clients.items()):
            if now_ns - client.received_ns > 5 * SECOND:
                del self.clients[address]
                self.counts["timed_out"] += 1
            else:
                yield address, client.version

    def _shot(
        self, number: int, exposed_ns: int, bodies: tuple[natnet.RigidBody, ...]
    ) -> natnet.NatNetFrame:
        """Create the NatNet frame of an exposure."""
        # as natnet reads them
        params = 2 * self.settings.models_changed | 4 * bool(self.acting.of_kind("edit_mode"))
        return natnet.NatNetFrame(number, bodies, params, self.ticks(exposed_ns))

    def _stream(self, frame: natnet.NatNetFrame, now_ns: int) -> None:
        """Send a frame to every receiver. Faults can change its version or damage the datagram.

        The frame counts as sent even if there is no receiver.
        """
        damaged_share = self.acting.largest_share("bad_datagrams")
        wrong_version = self.acting.newest("other_version")
        datagram_by_version: dict[natnet.Version, bytes] = {}
        for address, version in self._receivers(now_ns):
            if version not in datagram_by_version:
                sent_version = (
                    version
                    if wrong_version is None
                    else natnet.Version.parse(wrong_version.version)
                )
                datagram_by_version[version] = pack_answer(frame, sent_version)
            datagram = datagram_by_version[version]
            if damaged_share and self._random.random() < damaged_share:
                datagram = mangle(datagram, self._random)
            self._send(self.ports.data, datagram, address)
        self.counts["frames"] += 1

    def _send(self, sender: Any, data: bytes, to: Address) -> None:
        """Send a datagram. It is lost if a buffer is full or the client has gone."""
        with suppress(OSError):  # the datagram is lost if a buffer is full or the client has gone
            sender.sendto(data, to)


def _port_of(endpoint: Any) -> int:
    """Return the port number of a bound socket."""
    return endpoint.getsockname()[1]


def _create_bodies(
    section: OptitrackSection,
    settings: OptitrackSettings,
    bodies: Sequence[Body],
    random_generator: random.Random,
    acting: ActingFaults,
) -> list[TrackedBody]:
    """Create the rigid body of each robot, with its name and id from the spec or the script."""
    noise = PoseNoise(settings.noise_mm, settings.noise_rad, random_generator)
    override_by_name = {robot.name: robot for robot in settings.robots}
    taken_ids = {robot.body for robot in section.robots if isinstance(robot.body, int)}
    free_ids = (number for number in range(1, 1000) if number not in taken_ids)
    tracked: list[TrackedBody] = []
    for body in bodies:
        robot = entry(section.robots, body.name)
        number = robot.body if isinstance(robot.body, int) else next(free_ids)
        override = override_by_name.get(body.name, TrueBody(name=body.name))
        body_name = override.body or (robot.body if isinstance(robot.body, str) else robot.name)
        heading_offset = override.heading_offset
        heading_offset = robot.heading_offset if heading_offset is None else heading_offset
        asset = Asset(number, body_name, heading_offset, override.streamed)
        tracked.append(TrackedBody(body, asset, noise, acting))
    return tracked
