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
from tetractl.log.write.file_writer import protobuf_schema

PROTOCOL = "foxglove.sdk.v1"
TOPICS = {number: topic for topic, number in NUMBERS.items()}
"""Topics by the id of their channel, as in a log."""

_MESSAGE, _TIME = 1, 2  # first byte of a binary message to a client


def greeting(name: str) -> list[str]:
    """Return the first messages to a client: the server's description, and the topics with their
    schemas.
    """
    info: dict[str, object] = {"op": "serverInfo", "name": name, "capabilities": ["time"]}
    info["sessionId"] = secrets.token_hex(8)  # identifies the server to a viewer that reconnects
    channels = [
        {
            "id": number,
            "topic": topic,
            "encoding": MessageEncoding.Protobuf,
            "schemaName": name,
            "schemaEncoding": encoding,
            "schema": b64encode(schema).decode(),
        }
        for number, topic in TOPICS.items()
        for name, encoding, schema in [protobuf_schema(CHANNELS[topic])]
    ]
    return [json.dumps(info), json.dumps({"op": "advertise", "channels": channels})]


def subscription(number: int) -> bytes:
    """Return the bytes of a client's subscription number for `message`; OverflowError if the number
    is invalid.
    """
    return number.to_bytes(4, "little")


def message(subscription: bytes, entry: Entry) -> bytes:
    """Return a log's message as sent for one of a client's subscriptions."""
    return bytes([_MESSAGE]) + subscription + struct.pack("<Q", entry.log_ns) + entry.data


def time(time_ns: int) -> bytes:
    """Return the message that sets a viewer's time [Unix ns]."""
    return struct.pack("<BQ", _TIME, time_ns)
