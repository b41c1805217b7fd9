"""The messages of the protocol `foxglove.sdk.v1` that show a trial.

https://github.com/foxglove/ws-protocol specifies them. Topics, schemas and messages are those of a
log.
"""

import json
import secrets
import struct
from base64 import b64encode

from mcap.well_known import MessageEncoding

from tetractl.log.format.channels import CHANNELS, NUMBERS, Entry
from tetractl.log.write.mcap_records import protobuf_schema

PROTOCOL = "foxglove.sdk.v1"
TOPICS = {number: topic for topic, number in NUMBERS.items()}
"""Topics by the id of their channel, as in a log."""

_MESSAGE = 1
"""First byte of a message of a topic."""
_TIME = 2
"""First byte of a message that sets the time."""
_SESSION_BYTES = 8
"""Number of random bytes that identify the server to a viewer that reconnects."""


def greeting(name: str) -> list[str]:
    """Return the first messages to a client.

    They are the server's description, and the topics with their schemas.
    """
    info = {
        "op": "serverInfo",
        "name": name,
        "capabilities": ["time"],
        "sessionId": secrets.token_hex(_SESSION_BYTES),
    }
    channels = [_channel(number, topic) for number, topic in TOPICS.items()]
    return [json.dumps(info), json.dumps({"op": "advertise", "channels": channels})]


def _channel(number: int, topic: str) -> dict[str, object]:
    """Return the description of a topic."""
    schema = protobuf_schema(CHANNELS[topic])
    return {
        "id": number,
        "topic": topic,
        "encoding": MessageEncoding.Protobuf,
        "schemaName": schema.name,
        "schemaEncoding": schema.encoding,
        "schema": b64encode(schema.data).decode(),
    }


def subscription(number: int) -> bytes:
    """Return the bytes of a client's subscription number for `message`.

    Raises:
        OverflowError: If the number is invalid.
    """
    return number.to_bytes(4, "little")


def message(subscription: bytes, entry: Entry) -> bytes:
    """Return a log's message as sent for one of a client's subscriptions."""
    kind = bytes([_MESSAGE])
    time_ns = struct.pack("<Q", entry.log_ns)
    return kind + subscription + time_ns + entry.data


def time(time_ns: int) -> bytes:
    """Return the message that sets a viewer's time [Unix ns]."""
    return struct.pack("<BQ", _TIME, time_ns)
