"""A fake log viewer: a client of the server's protocol `foxglove.sdk.v1`."""

import json
import socket
import struct
from base64 import b64decode
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.sync.client import connect
from websockets.typing import Subprotocol

PATIENCE_S = 120.0  # before a test gives up; nothing waits for it to pass
PROTOCOL = Subprotocol("foxglove.sdk.v1")
# what a binary message from the server begins with
MESSAGE = 1
TIME = 2

SUBSCRIPTIONS_FROM = 100  # the number of a subscription is that of its channel and this


@dataclass
class Viewer:
    """A connection; `info` and `channels` are what the server says of itself.

    `all` is what came, in its order: messages and times as (topic, log time, bytes), the topic of
    a time being "time".
    """

    url: str
    all: list = field(default_factory=list)

    def __enter__(self):
        protocols = [Subprotocol("foxglove.websocket.v1"), PROTOCOL]  # as Lichtblick offers
        self._manager = connect(self.url, subprotocols=protocols, close_timeout=0.1)
        self.socket = self._manager.__enter__()
        self.info = json.loads(self.socket.recv(timeout=PATIENCE_S))
        advertised = json.loads(self.socket.recv(timeout=PATIENCE_S))
        self.channels = {channel["topic"]: channel for channel in advertised["channels"]}
        return self

    def __exit__(self, *error):
        self._manager.__exit__(*error)

    def subscribe(self, *topics):
        ids = [self.channels[topic]["id"] for topic in topics or self.channels]
        subscriptions = [{"id": SUBSCRIPTIONS_FROM + number, "channelId": number} for number in ids]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
        return self

    def until(self, condition) -> Any:
        """Read on until `condition` holds for something that came, and return that."""
        while True:
            got = self._next()
            self.all.append(got)
            if condition(got):
                return got

    def seen(self, condition) -> Any:
        """The same of what came already: times overtake messages, which wait in another queue."""
        return next((got for got in self.all if condition(got)), None) or self.until(condition)

    def message(self, topic):
        """Read on until a message of a topic comes; return its log time and the message."""
        _, log_ns, data = self.until(lambda got: got[0] == topic)
        return log_ns, self.decode(topic, data)

    def schema(self, topic):
        """The bytes of a topic's schema."""
        return b64decode(self.channels[topic]["schema"])

    def decode(self, topic, data) -> Any:
        """Decode bytes by the schema that the server sent, and no other."""
        channel = self.channels[topic]
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(b64decode(channel["schema"])).file:
            pool.Add(file)
        message_type = pool.FindMessageTypeByName(channel["schemaName"])
        return message_factory.GetMessageClass(message_type).FromString(data)

    def _next(self):
        got = self.socket.recv(timeout=PATIENCE_S)
        if isinstance(got, str):
            said = json.loads(got)
            return (said["op"], 0, said)
        if got[0] == MESSAGE:
            _, subscription, log_ns = struct.unpack_from("<BIQ", got)
            topics = {channel["id"]: topic for topic, channel in self.channels.items()}
            return (topics[subscription - SUBSCRIPTIONS_FROM], log_ns, got[13:])
        assert got[0] == TIME
        return ("time", struct.unpack_from("<Q", got, 1)[0], b"")


def deaf(url, count):
    """Return the socket of a client that subscribes to channels 1 to `count` and reads nothing."""
    where = urlsplit(url)
    stuck = socket.socket()
    stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stuck.settimeout(PATIENCE_S)
    stuck.connect((where.hostname, where.port))
    stuck.sendall(
        f"GET {where.path} HTTP/1.1\r\nHost: {where.netloc}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: {PROTOCOL}\r\n\r\n".encode()
    )
    answer = b""
    while b"\r\n\r\n" not in answer:
        answer += stuck.recv(1)
    subscriptions = [{"id": number, "channelId": number} for number in range(1, count + 1)]
    request = json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode()
    stuck.sendall(struct.pack(">BBHI", 0x81, 0xFE, len(request), 0) + request)
    return stuck
