"""Decides which datagrams come from the camera server, by its address and two of its ports.

Answers come from the port that commands are sent to. Frames come from one other port: in unicast
the port that SERVERINFO reports (from 3.0 on), otherwise the port of the first readable frame.
NatNet does not authenticate senders: packets from the server's address and port are accepted.
"""

from collections import Counter
from typing import NamedTuple

from tetractl.lab.cameras.optitrack.natnet import MessageKind

ANSWERS = frozenset(MessageKind) - {MessageKind.FRAME}


class Sender(NamedTuple):
    """The origin of datagrams: address and port, and whether they are frames or answers."""

    host: str
    port: int
    frames: bool

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


class Senders:
    """Admits the datagrams of one server and counts all others by their sender."""

    def __init__(self, server: str, command_port: int) -> None:
        self.server = server
        self.command_port = command_port
        self.frames_port: int | None = None
        self.refused: Counter[Sender] = Counter()
        self.refused_frame = b""  # the newest refused frame

    def admit(self, datagram: bytes, host: str, port: int) -> bool:
        """Return whether a datagram comes from the address and port for its kind.

        Until the frames' port is known, frames are admitted from every port of the server. A
        datagram of unknown kind counts as a frame, since it may be a damaged frame.
        """
        frame = int.from_bytes(datagram[:2], "little") not in ANSWERS
        expected = (self.frames_port or port) if frame else self.command_port
        if host == self.server and port == expected:
            return True
        sender = Sender(host, port, frame)
        # forged senders must not fill the memory
        if sender in self.refused or len(self.refused) < 64:
            self.refused[sender] += 1
        if frame:
            self.refused_frame = datagram
        return False

    def pin(self, port: int) -> None:
        """Admit frames only from this port from now on, unless it is 0; once a port is known, calls
        do nothing."""
        self.frames_port = self.frames_port or port

    def most(self, frames: bool) -> tuple[Sender, int] | None:
        """Return the sender of the most refused frames (if not `frames`: answers) and their number;
        None if none was refused.
        """
        senders = self.refused.most_common()
        return next((sender for sender in senders if sender[0].frames is frames), None)
