"""Settings, answers and clients of the emulated Motive; without sockets."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from tetractl.core.clock import SECOND
from tetractl.core.commands import EMULATED_NAME
from tetractl.lab.cameras.optitrack.natnet_messages import (
    MULTICAST_GROUP,
    Bare,
    BodyName,
    Connect,
    EchoRequest,
    EchoResponse,
    Message,
    MessageKind,
    ModelDef,
    NatNetRequest,
    Response,
    ServerInfo,
    Version,
)
from tetractl.lab.cameras.optitrack.pose import UpAxis

EMULATED_VERSION = Version(4, 1)


@dataclass(frozen=True, slots=True)
class Streaming:
    """Motive's streaming settings. Port 0 takes any free port; times are in seconds.

    The time from exposure to transmission has the mean `latency` and the deviation `jitter`; one
    frame in 250 is late by up to nearly half a frame. A version above 4.3 is packed as 4.3, with
    longer descriptions of rigid bodies. `keeps_version`: clients cannot choose another version;
    `answers_models`: requests for MODELDEF are answered; `models_changed`: every frame reports
    changed models; `unit_mm`: the answer to `UnitsToMillimeters`, though frames are in metres.
    """

    address: str = "127.0.0.1"
    command_port: int = 1510
    data_port: int = 1511
    transport: Literal["unicast", "multicast"] = "unicast"
    group: str = MULTICAST_GROUP
    version: Version = EMULATED_VERSION
    rate_hz: float = 120.0
    latency: float = 0.0054
    jitter: float = 0.00025
    client_timeout: float = 5.0
    frames_from: str | None = None  # a separate address, like that of a second network card
    keeps_version: bool = False
    answers_models: bool = True
    models_changed: bool = False
    unit_mm: float = 1000.0
    up: UpAxis = UpAxis.Y
    knows_up_axis: bool = True


@dataclass(slots=True)
class Trouble:
    """State that faults set: silent (no answers, no frames), no frames, the same frame repeated, a
    frame counter set back, edit mode, a share of damaged datagrams, or a number of `outdated`
    frames whose time stamps are `outdated_s` too old.
    """

    silent: bool = False
    no_frames: bool = False
    frozen: bool = False
    counter: int = 0
    edit_mode: bool = False
    damaged: float = 0.0
    version: Version | None = None
    outdated: int = 0
    outdated_s: float = 0.0


@dataclass(slots=True)
class Client:
    """A unicast client: the version it asked for, and the time of its last message."""

    version: Version
    heard_ns: int


@dataclass(slots=True)
class ServerCounts:
    """Counters of the server."""

    frames: int = 0
    datagrams: int = 0
    refused: int = 0
    models_asked: int = 0
    timed_out: int = 0


CLOCK_HZ = 10_000_000
CLOCK_OFFSET = 0x1234_5678_9ABC  # arbitrary start of the server's clock [ticks]
Address = tuple[str, int]


@dataclass(slots=True)
class ServerClock:
    """The server's clock: from `since_ns` of the host's on it runs at `rate`, `ahead_ns` ahead."""

    ahead_ns: int = 0
    rate: float = 1.0
    since_ns: int = 0

    def ticks(self, when_ns: int) -> int:
        """Return the server clock's ticks at a time of the host [ns]."""
        gained = round((self.rate - 1.0) * max(0, when_ns - self.since_ns))
        return CLOCK_OFFSET + (when_ns + self.ahead_ns + gained) * CLOCK_HZ // SECOND


class MotiveServer:
    """Answers clients and keeps a list of them; `on_client` is called with each new client's
    address.

    `data_port` is the port that frames come from or, in multicast, go to.
    """

    def __init__(
        self,
        streaming: Streaming,
        names: Sequence[BodyName],
        counts: ServerCounts,
        on_client: Callable[[str], None],
    ) -> None:
        self.streaming = streaming
        self.clients: dict[Address, Client] = {}
        self.data_port = streaming.data_port
        self.clock = ServerClock()
        self._names = tuple(names)
        self._counts = counts
        self._on_client = on_client
        self._greeted: set[Address] = set()

    def version(self, client: Address) -> Version:
        """Return the protocol version in which a client is served."""
        known = self.clients.get(client)
        return known.version if known else self.streaming.version

    def answer(self, message: Message, sender: Address, now_ns: int) -> Message | None:
        """Return the answer to a message, None if the server gives no answer."""
        if sender in self.clients:
            self.clients[sender].heard_ns = now_ns
        match message:
            case Connect():
                self._admit(message, sender, now_ns)
                return self._info()
            case EchoRequest(client):
                return EchoResponse(client, self.clock.ticks(now_ns))
            case NatNetRequest(text) if text.startswith("Bitstream,"):
                return self._change_version(text.removeprefix("Bitstream,"), sender)
            case NatNetRequest(text):
                return self._reply(text)
            case Bare(MessageKind.REQUEST_MODELDEF):
                self._counts.models_asked += 1
                return ModelDef(self._names) if self.streaming.answers_models else None
            case Bare(MessageKind.DISCONNECT):
                self.clients.pop(sender, None)
        return None

    def receivers(self, now_ns: int) -> list[tuple[Address, Version]]:
        """Return the addresses that frames go to, each with its version; unicast clients
        time out.
        """
        s = self.streaming
        if s.transport == "multicast":
            return [((s.group, self.data_port), s.version)]
        silent = round(s.client_timeout * SECOND)
        for address, client in list(self.clients.items()):
            if now_ns - client.heard_ns > silent:
                del self.clients[address]
                self._counts.timed_out += 1
        return [(address, client.version) for address, client in self.clients.items()]

    def _admit(self, message: Connect, sender: Address, now_ns: int) -> None:
        if sender not in self._greeted:
            self._greeted.add(sender)
            self._on_client(f"{sender[0]}:{sender[1]}")
        if self.streaming.transport == "multicast":
            return
        version = self.streaming.version
        if message.bitstream is not None and self._can_change(asked := message.bitstream[:2]):
            version = Version(*asked)
        self.clients[sender] = Client(version, now_ns)

    def _can_change(self, asked: tuple[int, int]) -> bool:
        """Return whether a unicast client may choose this version, as it can with servers from 4.0
        on.
        """
        version = Version(*asked)
        if self.streaming.keeps_version:
            return False
        return (4, 0) <= self.streaming.version >= version and version.known

    def _change_version(self, text: str, sender: Address) -> Message:
        major, _, minor = text.partition(".")
        known = self.clients.get(sender)
        numbers = major.isdecimal() and minor.isdecimal()
        if known and numbers and self._can_change((int(major), int(minor))):
            known.version = Version(int(major), int(minor))
            return Response(struct.pack("<i", 0))
        return Response(struct.pack("<i", 1))

    def _info(self) -> ServerInfo:
        a, b, c, d = (int(part) for part in self.streaming.group.split("."))
        major, minor = self.streaming.version
        return ServerInfo(
            f"Motive ({EMULATED_NAME})",
            (3, 0, 0, 0),
            (major, minor, 0, 0),
            CLOCK_HZ,
            self.data_port,
            self.streaming.transport == "multicast",
            (a, b, c, d),
        )

    def _reply(self, text: str) -> Message:
        match text:
            case "FrameRate":
                return Response(struct.pack("<f", self.streaming.rate_hz))
            case "UnitsToMillimeters":
                return Response(struct.pack("<f", self.streaming.unit_mm))
            case "UpAxis" if self.streaming.knows_up_axis:
                return Response(struct.pack("<i", self.streaming.up))
            case _:
                return Bare(MessageKind.UNRECOGNIZED)
