"""The messages of the protocol `foxglove.sdk.v1` that show a trial and control a playback.

https://github.com/foxglove/ws-protocol specifies them; the messages that control a playback are
those of foxglove-sdk 0.30. Topics, schemas and messages are those of a log.
"""

import json
import secrets
import struct
from base64 import b64encode
from dataclasses import dataclass

from mcap.well_known import MessageEncoding

from tetractl.log.format.channels import CHANNELS, Entry
from tetractl.log.write.sink import protobuf_schema
from tetractl.replay.player import Playback

PROTOCOL = "foxglove.sdk.v1"
TOPICS = dict(enumerate(CHANNELS, 1))
"""Topics by the id of their channel, as in a log."""

_MESSAGE, _TIME, _STATE = 1, 2, 5  # first byte of a binary message to a client
_CONTROL = 3  # first byte of a binary message from a client
_STATUS = {Playback.PLAYING: 0, Playback.PAUSED: 1, Playback.ENDED: 3}


@dataclass(frozen=True, slots=True)
class Request:
    """A viewer's request: play or pause, rate, time to seek [Unix ns].

    `rate` is in seconds of the trial per second; `seek_ns` is None to keep the time.
    """

    playing: bool
    rate: float
    seek_ns: int | None


@dataclass(frozen=True, slots=True)
class PlaybackState:
    """The state of a playback at a time [Unix ns]; `sought` is True after a jump to that time."""

    playback: Playback
    time_ns: int
    rate: float
    sought: bool = False


def greeting(name: str, span_ns: tuple[int, int] | None) -> list[str]:
    """Return the first messages to a client: the server's description, and the topics with their
    schemas.

    If the span of a recording [Unix ns] is given, viewers show controls for the playback.
    """
    info: dict[str, object] = {"op": "serverInfo", "name": name, "capabilities": ["time"]}
    info["sessionId"] = secrets.token_hex(8)  # identifies the server to a viewer that reconnects
    if span_ns:
        info["capabilities"] = ["time", "playbackControl"]
        for which, time_ns in zip(("dataStartTime", "dataEndTime"), span_ns, strict=True):
            info[which] = {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}
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


def playback_state(state: PlaybackState, request: bytes = b"") -> bytes:
    """Return the message of a playback's state; `request` names the request that it answers, if
    any.
    """
    status = _STATUS[state.playback]
    fields = _STATE, status, state.time_ns, state.rate, state.sought, len(request)
    return struct.pack("<BBQfBI", *fields) + request


def control(said: bytes) -> tuple[Request, bytes] | None:
    """Decode a request and its name; None if `said` is not a request, struct.error if it is cut
    short.
    """
    if said[:1] != bytes([_CONTROL]):
        return None
    _, pausing, rate, seeking, seek_ns, length = struct.unpack_from("<BBfBQI", said)
    return Request(not pausing, rate, seek_ns if seeking else None), said[19 : 19 + length]
