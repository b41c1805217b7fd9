"""Decide by address and port which datagrams come from the camera server.

The server answers from the port that commands are sent to. Its frames come from one other port: in
unicast, the port that SERVERINFO reports (since protocol 3.0), otherwise the port of the first
readable frame. NatNet does not authenticate senders, so a packet that is sent with the server's
address and port is accepted.
"""

from collections import Counter
from typing import NamedTuple

from tetractl.lab.cameras.optitrack.natnet import MessageKind

ANSWER_KINDS = frozenset(MessageKind) - {MessageKind.FRAME}
"""Kinds of messages with which the server answers requests: all except frames."""
REFUSED_SENDERS_MAX = 64
"""Maximum number of refused senders that are counted. Forged ones must not fill the memory."""


class Sender(NamedTuple):
    """The origin of datagrams that were refused, and whether they were frames or answers.

    Attributes:
        host: IP address.
        port: UDP port.
        sends_frames: True if the datagrams are frames, False if they are answers.
    """

    host: str
    port: int
    sends_frames: bool

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


class SenderFilter:
    """A filter that accepts the datagrams of one server, and counts all others by their sender.

    Attributes:
        frames_port: The port that frames come from; None while it is unknown.
        refused: Number of refused datagrams of each sender.
        refused_frame: The newest refused frame; empty if there is none.
    """

    def __init__(self, server: str, command_port: int) -> None:
        self.server = server
        self.command_port = command_port
        self.frames_port: int | None = None
        self.refused: Counter[Sender] = Counter()
        self.refused_frame = b""

    def accept(self, datagram: bytes, host: str, port: int) -> bool:
        """Check whether a datagram comes from the server. If it does not, count it as refused.

        While the frames' port is unknown, frames are accepted from every port of the server. A
        datagram of unknown kind is treated as a frame, because it may be a damaged frame.

        Args:
            datagram: The whole datagram.
            host: IP address of its sender.
            port: UDP port of its sender.
        """
        is_frame = int.from_bytes(datagram[:2], "little") not in ANSWER_KINDS
        expected_port = (self.frames_port or port) if is_frame else self.command_port
        if host == self.server and port == expected_port:
            return True
        sender = Sender(host, port, is_frame)
        if sender in self.refused or len(self.refused) < REFUSED_SENDERS_MAX:
            self.refused[sender] += 1
        if is_frame:
            self.refused_frame = datagram
        return False

    def fix_frames_port(self, port: int) -> None:
        """Accept frames from this port only. Once a port is fixed, later calls change nothing.

        A port of 0 means that the port is unknown, and is ignored.
        """
        self.frames_port = self.frames_port or port

    def find_main_refused_sender(self, *, sends_frames: bool) -> tuple[Sender, int] | None:
        """Find the sender whose frames (or answers) were refused most often.

        Returns:
            The sender and the number of its refused datagrams; None if none was refused.
        """
        for sender, count in self.refused.most_common():
            if sender.sends_frames is sends_frames:
                return sender, count
        return None
