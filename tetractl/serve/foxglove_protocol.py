"""The messages of the protocol `foxglove.sdk.v1`, by which the viewer Foxglove receives a trial.

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


def build_greeting(name: str) -> list[str]:
    """Build the first messages that a new viewer receives.

    They describe the server, and the topics with their schemas.
    """
    info = {
        "op": "serverInfo",
        "name": name,
        "capabilities": ["time"],
        "sessionId": secrets.token_hex(_SESSION_BYTES),
    }
    channels = [_describe_channel(number, topic) for number, topic in TOPICS.items()]
    return [json.dumps(info), json.dumps({"op": "advertise", "channels": channels})]


def _describe_channel(number: int, topic: str) -> dict[str, object]:
    """Describe a topic as the protocol requires: its name, its encoding and its schema."""
    schema = protobuf_schema(CHANNELS[topic])
    return {
        "id": number,
        "topic": topic,
        "encoding": MessageEncoding.Protobuf,
        "schemaName": schema.name,
        "schemaEncoding": schema.encoding,
        "schema": b64encode(schema.data).decode(),
    }


def encode_subscription(number: int) -> bytes:
    """Encode a viewer's subscription id as the bytes with which messages of its topic begin.

    Raises:
        OverflowError: If the id is negative or needs more than four bytes.
    """
    return number.to_bytes(4, "little")


def encode_message(subscription: bytes, entry: Entry) -> bytes:
    """Encode a message of the log for a viewer that has subscribed to the message's topic.

    Args:
        subscription: The encoded id of the subscription.
        entry: The message.
    """
    opcode = bytes([_MESSAGE])
    time_ns = struct.pack("<Q", entry.log_ns)
    return opcode + subscription + time_ns + entry.data


def encode_time(time_ns: int) -> bytes:
    """Encode the message that sets the time which a viewer shows [Unix ns]."""
    return struct.pack("<BQ", _TIME, time_ns)
