"""The records of a log by name: channels with their schemas, and attachments.

Host records describe the machine and the time, so they differ between two runs of the same trial;
all other records of a simulated trial's log repeat byte for byte.
"""

from typing import NamedTuple

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message

from tetractl.log.format import tetractl_pb2 as pb

FORMAT_VERSION = 4
WRITER = "tetractl"
"""The first word of the library that a log's header names."""
METADATA = ("tetractl", {"format": str(FORMAT_VERSION)})
"""Name and contents of a log's only record of metadata."""

TEXT = 2000
"""Largest number of characters of an operator message, after which a reader cuts it; control
characters are escaped.
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
CAMERA = "/camera/"
"""With what the channels begin on which a camera adds messages to its frames, in this version or an
earlier one: they are logged as they are, and nothing follows from them.
"""
PICTURE = f"{CAMERA}picture"
BACKGROUND = f"{CAMERA}background"
HOST_END = "/host/end"
RESULT = "/result"
DIGESTS = "/digests"
RECOVERED = "/recovered"
SUMMARY = frozenset({RUN, HOST, HOST_END, RESULT, DIGESTS, RECOVERED})
"""The channels of the run and its result; of two messages of one of them, the first counts."""

CHANNELS: dict[str, type[Message]] = {
    RUN: pb.Run,
    HOST: pb.Host,
    FRAMES: pb.CameraFrames,
    TRANSFORMS: FrameTransforms,
    STEP: pb.ControllerStep,
    COMMANDS: pb.WheelCommand,
    SCENE: SceneUpdate,
    SCENE_PLAN: SceneUpdate,
    LOG: Log,
    HOST_TIMING: pb.StepTiming,
    PICTURE: CompressedImage,
    BACKGROUND: CompressedImage,
    HOST_END: pb.HostEnd,
    RESULT: pb.Result,
    DIGESTS: pb.Digests,
    RECOVERED: pb.Recovered,
}
"""Topic and message of each channel."""
NUMBERS = {
    RUN: 1,
    HOST: 2,
    FRAMES: 3,
    TRANSFORMS: 4,
    STEP: 5,
    COMMANDS: 6,
    SCENE: 7,
    SCENE_PLAN: 8,
    LOG: 9,
    HOST_TIMING: 10,
    PICTURE: 13,
    BACKGROUND: 14,
    HOST_END: 15,
    RESULT: 16,
    DIGESTS: 17,
    RECOVERED: 18,
}
"""The number of each channel, which identifies its messages if the record of the channel is lost.
It is part of the format version. Earlier logs have other channels under 11 and 12.
"""

SPEC = "spec.yaml"
RESOLVED_SPEC = "spec.resolved.yaml"
ENVIRONMENT = "environment.json"
LAYOUT = "layout.json"
TRACK = "track.json"
"""In the log of `tetractl track`, which is of no trial: what the command prints with --json."""

HOST_RECORDS = frozenset({HOST_TIMING, HOST, HOST_END, ENVIRONMENT})
"""Topics and attachments that differ between two runs of the same trial."""


class Entry(NamedTuple):
    """One message: its topic, when the host received or sent it (`log_ns`), when its content was
    sampled (`publish_ns`) [Unix ns], and its bytes.
    """

    topic: str
    log_ns: int
    publish_ns: int
    data: bytes
