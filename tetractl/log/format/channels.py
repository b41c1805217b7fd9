"""The names of all records in a log: channels with their schemas, and attachments.

Host records describe the machine and the time, so they differ between two runs of the same trial.
All other records of a simulated trial's log repeat byte for byte.
"""

from typing import NamedTuple

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from mcap.records import Attachment

from tetractl.core.poses import BACKGROUND_TOPIC, PICTURE_TOPIC
from tetractl.log.format import tetractl_pb2 as pb

FORMAT_VERSION = 4
"""Version of the log format that this version of tetractl writes and reads."""
MAGIC = b"\x89MCAP0\r\n"
"""The first and also the last bytes of an MCAP file."""
WRITER = "tetractl"
"""Beginning of the name of the library in the header of a log that tetractl wrote."""
METADATA = ("tetractl", {"format": str(FORMAT_VERSION)})
"""Name and contents of a log's only metadata record, which states the format."""

NOTE_LENGTH_MAX = 2000
"""Maximum number of characters of an operator message.

A longer message is cut when it is logged or read. Control characters are escaped.
"""

RUN = "/run"
HOST = "/host/machine"
FRAMES = "/frames"
TRANSFORMS = "/tf"
STEP = "/controller/step"
COMMANDS = "/commands"
SCENE = "/scene/static"
SCENE_PLAN = "/scene/plan"
LOG = "/log"
HOST_TIMING = "/host/timing"
HOST_END = "/host/end"
RESULT = "/result"
DIGESTS = "/digests"
RECOVERED = "/recovered"
SUMMARY = frozenset({RUN, HOST, HOST_END, RESULT, DIGESTS, RECOVERED})
"""The channels of the run and its result. If one has several messages, the first message counts.
"""

TABLE: tuple[tuple[int, str, type[Message]], ...] = (
    (1, RUN, pb.Run),
    (2, HOST, pb.Host),
    (3, FRAMES, pb.CameraFrames),
    (4, TRANSFORMS, FrameTransforms),
    (5, STEP, pb.ControllerStep),
    (6, COMMANDS, pb.WheelCommand),
    (7, SCENE, SceneUpdate),
    (8, SCENE_PLAN, SceneUpdate),
    (9, LOG, Log),
    (10, HOST_TIMING, pb.StepTiming),
    (13, PICTURE_TOPIC, CompressedImage),
    (14, BACKGROUND_TOPIC, CompressedImage),
    (15, HOST_END, pb.HostEnd),
    (16, RESULT, pb.Result),
    (17, DIGESTS, pb.Digests),
    (18, RECOVERED, pb.Recovered),
)
"""Number, topic and message type of each channel.

The number identifies its messages if the record of the channel is lost. It is part of the format
version: earlier logs have other channels under 11 and 12.
"""
CHANNELS = {topic: message for _, topic, message in TABLE}
NUMBERS = {topic: number for number, topic, _ in TABLE}

SPEC = "spec.yaml"
RESOLVED_SPEC = "spec.resolved.yaml"
ENVIRONMENT = "environment.json"
LAYOUT = "layout.json"

HOST_RECORDS = frozenset({HOST_TIMING, HOST, HOST_END, ENVIRONMENT})
"""Topics and names of attachments that differ between two runs of the same trial."""


class Entry(NamedTuple):
    """One message of a log: its channel, its times and its encoded contents.

    Attributes:
        topic: Topic of the message's channel.
        log_ns: Time at which the host received or sent the message's content [Unix ns].
        publish_ns: Time at which the content was sampled [Unix ns].
        data: The encoded message.
    """

    topic: str
    log_ns: int
    publish_ns: int
    data: bytes


Record = Entry | Attachment
"""A message or an attachment of a log."""
