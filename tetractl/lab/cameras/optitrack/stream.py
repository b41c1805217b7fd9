"""A NatNet connection without its sockets: datagrams in, camera frames and counts out.

The same code reads a live server and a recorded wire.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab.cameras.optitrack.handshake import response_float, response_int
from tetractl.lab.cameras.optitrack.messages import (
    EchoResponse,
    Message,
    MessageKind,
    ModelDef,
    NatNetFrame,
    Request,
    Response,
    ServerInfo,
    Version,
)
from tetractl.lab.cameras.optitrack.placement import Placement, fault_of
from tetractl.lab.cameras.optitrack.pose import UpAxis
from tetractl.lab.cameras.optitrack.sync import ClockSync
from tetractl.lab.cameras.optitrack.wire import parse
from tetractl.lab.errors import WireError

AGE_MAX_NS = 60_000_000_000  # a frame said to be older than this was not exposed by these cameras
REORDERED = 10  # a frame this little behind the newest was overtaken on its way
UP_AXIS, FRAME_RATE = "UpAxis", "FrameRate"


@dataclass(frozen=True, slots=True)
class Tracked:
    """A robot as the cameras know it: a rigid body by name or id, and its heading offset [rad]."""

    body: str | int
    heading_offset: float = 0.0


@dataclass(slots=True)
class StreamCounts:
    """What came of the datagrams; every number only grows."""

    frames: int = 0
    missed: int = 0  # numbers skipped between frames
    overtaken: int = 0  # frames behind a newer one, or twice the same
    bad: int = 0  # datagrams that are no NatNet message
    early: int = 0  # frames and models before the version was known


class Stream:
    """What is known of a server and its newest frame.

    `pinned` is the version CONNECT asked for, in unicast; `up` the vertical axis where the spec
    tells it. `feed` never raises on data. Times are ns on the host's clock.
    """

    def __init__(
        self,
        robots: Sequence[Tracked],
        placement: Placement,
        pinned: Version | None = None,
        up: UpAxis | None = None,
        on_frame: Callable[[CameraFrame], None] = lambda frame: None,
    ) -> None:
        self.robots = tuple(robots)
        self.counts = StreamCounts()
        self.info: ServerInfo | None = None
        self.up = up
        self.camera_rate_hz: float | None = None
        self.model: ModelDef | None = None
        self.models_changed = False
        self.sync: ClockSync | None = None
        self.newest: CameraFrame | None = None
        self._placement = placement
        self._pinned = pinned
        self._on_frame = on_frame
        self._asked: str | None = None
        self._fault = ""

    @property
    def version(self) -> Version | None:
        """The protocol version frames come in, None before SERVERINFO."""
        return self._pinned if self._pinned and self.info else self.info and self.info.version

    @property
    def latency_ns(self) -> int | None:
        """Age of the newest frame when it came, None where it cannot be told."""
        if self.newest is None or self.sync is None or not self.sync.synced:
            return None
        return self.newest.received_ns - self.newest.sampled_ns

    def missing(self) -> list[str | int]:
        """Return the bodies that the server does not stream by that name or id."""
        if self.model is None:
            return [robot.body for robot in self.robots]
        ids = self.model.ids()
        known = set(ids.values())
        wanted = (
            (r.body, ids.get(r.body) if isinstance(r.body, str) else r.body) for r in self.robots
        )
        return [body for body, number in wanted if number not in known]

    def asked(self, request: Request) -> None:
        """Note the request that the next RESPONSE answers."""
        self._asked = request.text

    def feed(self, datagram: bytes, received_ns: int) -> Message | None:
        """Take one datagram; return what it says, None for one that is dropped and counted."""
        try:
            message = parse(datagram, self.version)
            self._take(message, received_ns)
        except WireError:
            kind = int.from_bytes(datagram[:2], "little")
            if self.info is None and kind in (MessageKind.FRAME, MessageKind.MODELDEF):
                self.counts.early += 1
            else:
                self.counts.bad += 1
            return None
        return message

    def _take(self, message: Message, received_ns: int) -> None:
        match message:
            case NatNetFrame():
                self._frame(message, received_ns)
            case ServerInfo():
                if self.info is None and message.clock_hz:
                    self.sync = ClockSync(message.clock_hz)
                self.info = message
            case ModelDef():
                self.model, self.models_changed = message, False
            case EchoResponse(client, server) if self.sync is not None:
                self.sync.add(client, received_ns, server)
            case Response():
                self._response(message)
            case _:
                pass

    def _response(self, response: Response) -> None:
        asked, self._asked = self._asked, None
        if asked == UP_AXIS and self.up is None:
            value = response_int(response)
            if value in (UpAxis.Y, UpAxis.Z):
                self.up = UpAxis(value)
        elif asked == FRAME_RATE:
            rate = response_float(response)
            self.camera_rate_hz = rate if 1.0 <= rate <= 10_000.0 else None

    def _frame(self, frame: NatNetFrame, received_ns: int) -> None:
        sampled_ns = self._exposed(frame, received_ns)
        before = self.newest
        if before is not None and frame.number <= before.number:
            if frame.number >= before.number - REORDERED:
                self.counts.overtaken += 1
                return
            self._fault = (
                f"the frame counter went back from {before.number} to {frame.number}: "
                "the server was restarted, or plays a recording"
            )
        self.counts.frames += 1
        if before is not None and not self._fault:
            self.counts.missed += frame.number - before.number - 1
        self.models_changed |= frame.models_changed
        self.newest = self._camera_frame(frame, sampled_ns, received_ns)
        self._on_frame(self.newest)

    def _exposed(self, frame: NatNetFrame, received_ns: int) -> int:
        if frame.ticks is None or self.sync is None or not self.sync.synced:
            return received_ns
        sampled_ns = min(received_ns, self.sync.to_host(frame.ticks.exposure))
        if received_ns - sampled_ns > AGE_MAX_NS:
            raise WireError(f"a frame exposed {(received_ns - sampled_ns) / SECOND:.0f} s ago")
        return sampled_ns

    def _camera_frame(self, frame: NatNetFrame, sampled_ns: int, received_ns: int) -> CameraFrame:
        ids = self.model.ids() if self.model else {}
        by_id = {body.id: body for body in frame.bodies}
        poses: list[Pose | None] = []
        for robot in self.robots:
            number = ids.get(robot.body) if isinstance(robot.body, str) else robot.body
            body = None if number is None else by_id.pop(number, None)
            if body is None or self.up is None:
                poses.append(None)
            else:
                poses.append(self._placement.pose(body, self.up, robot.heading_offset))
        strangers = [self._placement.pose(body, self.up) for body in by_id.values() if self.up]
        return CameraFrame(
            number=frame.number,
            sampled_ns=sampled_ns,
            received_ns=received_ns,
            poses=tuple(poses),
            strangers=tuple(pose for pose in strangers if pose is not None),
            fault=self._fault or fault_of(frame),
        )
