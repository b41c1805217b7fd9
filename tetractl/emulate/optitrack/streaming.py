"""How the emulated Motive streams, what it knows of its clients, and what faults do to it."""

from dataclasses import dataclass
from typing import Literal

from tetractl.lab.cameras.optitrack.messages import MULTICAST_GROUP, Version
from tetractl.lab.cameras.optitrack.pose import UpAxis

EMULATED_VERSION = Version(4, 1)


@dataclass(frozen=True, slots=True)
class Streaming:
    """Motive's streaming settings. Port 0 takes any that is free; times in seconds.

    Exposure to transmit is `latency` on the mean with a deviation of `jitter`; one frame in 250
    is late by up to nearly half a frame. A version above 4.3 is packed as 4.3, with longer
    descriptions of rigid bodies. `keeps_version`: clients cannot have another; `answers_models`:
    MODELDEF is answered; `models_changed`: every frame reports changed models; `unit_mm`: the
    answer to `UnitsToMillimeters`, though frames are in metres.
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
    frames_from: str | None = None  # an address of its own, as of a second network card
    keeps_version: bool = False
    answers_models: bool = True
    models_changed: bool = False
    unit_mm: float = 1000.0
    up: UpAxis = UpAxis.Y
    knows_up_axis: bool = True


@dataclass(slots=True)
class Trouble:
    """What faults set: silent (answers nothing, sends nothing), no frames, the same frame again
    and again, the counter back by so many, edit mode, a share of damaged datagrams, or so many
    `outdated` frames, stamped `outdated_s` too old."""

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
    """A unicast client: the version it asked for and when it was last heard."""

    version: Version
    heard_ns: int


@dataclass(slots=True)
class ServerCounts:
    """What the server has seen and done."""

    frames: int = 0
    datagrams: int = 0
    refused: int = 0
    models_asked: int = 0
    timed_out: int = 0
