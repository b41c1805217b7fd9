"""Turn NatNet datagrams into camera frames, and synchronise the server's clock with the host's.

The code uses no sockets. Echoes of the server's time give offset and drift of its clock against the
host's clock. An echo states that the server's clock showed `ticks` at some time between the
request's sending and the answer's return; the time halfway is the best estimate, with an error of
at most half the round trip. Therefore only the echoes with the shortest round trips are used, also
for the fit of the drift. Any two echoes bound the rate of the server's clock between them, even if
network or host are slow. If the server's clock gained or lost more than `DRIFT_MAX` [s/s], it was
set or runs at a wrong rate, and `fault` contains a message.
"""

import statistics
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.errors import WireError
from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.natnet import Placement, UpAxis
from tetractl.lab.cameras.optitrack.section import TrackedRobot
from tetractl.lab.cameras.optitrack.wire import parse_datagram, read_number

DRIFT_MAX = 1e-3
"""Maximum drift between the server's clock and the host's [s/s]."""


@dataclass(frozen=True, slots=True)
class Echo:
    """One exchange of times with the server, which compares its clock with the host's.

    Attributes:
        host_ns: The host's time halfway between request and answer [ns].
        server_ns: The server's clock at that time [ns].
        round_trip_ns: Time from request to answer [ns].
    """

    host_ns: int
    server_ns: int
    round_trip_ns: int


class ClockSync:
    """Converts times of a server's clock [ticks] to times of the host's clock [ns].

    The conversion needs at least one echo.

    Args:
        clock_hz: Rate of the server's clock [ticks/s].

    Attributes:
        drift: Gain of the server's clock on the host's [s/s].
        fault: Description of the first fault of the server's clock. Empty if it has none.
        is_synced: Whether an echo was added, so that `to_host` can convert times.
    """

    def __init__(self, clock_hz: int) -> None:
        self.clock_hz = clock_hz
        self.drift = 0.0
        self.fault = ""
        self.is_synced = False
        self._resolution_ns = 2 * SECOND // clock_hz + 1
        self._echoes: deque[Echo] = deque(maxlen=120)
        self._reference_echo = Echo(0, 0, 0)

    @property
    def round_trip_ns(self) -> int:
        """Round trip of the echo that `to_host` uses to convert times [ns].

        Half of it is the maximum error near that echo.
        """
        return self._reference_echo.round_trip_ns

    def add(self, sent_ns: int, returned_ns: int, ticks: int) -> None:
        """Add an exchange of times with the server, and update the conversion.

        The exchange is ignored if the answer took more than a second.

        Args:
            sent_ns: When the host sent the request [ns].
            returned_ns: When the answer returned [ns].
            ticks: The server's time in the answer [ticks].
        """
        if not 0 <= returned_ns - sent_ns <= SECOND:
            return
        halfway = (sent_ns + returned_ns) // 2
        server_ns = ticks * SECOND // self.clock_hz
        echo = Echo(halfway, server_ns, returned_ns - sent_ns)
        self.fault = self.fault or self._find_contradiction(echo)
        self._echoes.append(echo)
        self.is_synced = True
        fastest_echoes = sorted(self._echoes, key=lambda echo: echo.round_trip_ns)
        # the quarter with the shortest round trips
        fastest_echoes = fastest_echoes[: max(1, round(0.25 * len(fastest_echoes)))]
        self._reference_echo = max(fastest_echoes, key=lambda echo: echo.host_ns)
        self.drift = _fit_drift(fastest_echoes)

    def to_host(self, ticks: int) -> int:
        """Return the host time [ns] at which the server's clock showed `ticks`."""
        server_offset_ns = ticks * SECOND // self.clock_hz - self._reference_echo.server_ns
        return self._reference_echo.host_ns + round(server_offset_ns / (1.0 + self.drift))

    def error_ns(self, host_ns: int) -> int:
        """Return the maximum error of `to_host` for times near a host time [ns]."""
        # the error of `drift` is at most twice DRIFT_MAX
        drifted = 2 * DRIFT_MAX * abs(host_ns - self._reference_echo.host_ns)
        return self._reference_echo.round_trip_ns // 2 + round(drifted) + self._resolution_ns

    def _find_contradiction(self, new_echo: Echo) -> str:
        """Return a message if the server's clock jumped or runs at a wrong rate, else "".

        It compares a new echo with all earlier ones.
        """
        for earlier_echo in reversed(self._echoes):
            span_ns = new_echo.host_ns - earlier_echo.host_ns
            gained_ns = new_echo.server_ns - earlier_echo.server_ns - span_ns
            uncertainty_ns = (
                earlier_echo.round_trip_ns + new_echo.round_trip_ns
            ) // 2 + self._resolution_ns
            if abs(gained_ns) > uncertainty_ns + DRIFT_MAX * abs(span_ns):
                return (
                    f"the camera server's clock {('gained' if gained_ns > 0 else 'lost')} "
                    f"{abs(gained_ns) / 1000000.0:.1f} ms on this computer's clock within "
                    f"{span_ns / SECOND:.2f} s: somebody set it, or it runs at a wrong rate"
                )
        return ""


def _fit_drift(echoes: list[Echo]) -> float:
    """Fit the drift of the server's clock against the host's to echoes [s/s].

    It is 0 if they span less than 5 s, and at most DRIFT_MAX in magnitude.
    """
    first_echo = echoes[0]
    host_offsets_ns = [echo.host_ns - first_echo.host_ns for echo in echoes]
    if (
        max(host_offsets_ns) - min(host_offsets_ns) < 5 * SECOND
    ):  # too short a span for a fit of the drift
        return 0.0
    gained_ns = [
        (echo.server_ns - first_echo.server_ns) - host_offset_ns
        for echo, host_offset_ns in zip(echoes, host_offsets_ns, strict=True)
    ]
    slope = statistics.linear_regression(host_offsets_ns, gained_ns).slope
    return max(-DRIFT_MAX, min(DRIFT_MAX, slope))


AGE_MAX_NS = 60 * SECOND  # a frame with a larger age was not exposed by these cameras
UP_AXIS_SETTING = "UpAxis"
UNITS_SETTING = "UnitsToMillimeters"
EDIT_MODE = "Motive is in edit mode, in which it streams a recording"


@dataclass(slots=True)
class StreamCounts:
    """Counts of received frames, and of datagrams that were dropped or could not be read.

    Attributes:
        frames: Number of frames that were used.
        unread: Number of datagrams that could not be read.
        unrequested: Number of answers that were dropped, because no open request matches.
        unread_frames: Number of unread datagrams that contain a frame.
        unread_models: Number of unread datagrams that contain a MODELDEF.
    """

    frames: int = 0
    unread: int = 0
    unrequested: int = 0
    unread_frames: int = 0
    unread_models: int = 0


class OpenRequests:
    """The requests to an OptiTrack server that are not answered yet.

    Only the last of the text requests is kept.
    """

    def __init__(self) -> None:
        self._text: str | None = None
        self._counts: Counter[type[natnet.ServerMessage]] = Counter()
        """Number of open requests, by the type of the answer."""
        self._echoes: deque[int] = deque(maxlen=64)
        """The host's times in open echo requests [ns]."""

    def add(self, request: natnet.ClientMessage) -> None:
        """Record a request that was sent to the server, until its answer arrives."""
        match request:
            case natnet.NatNetRequest(text):
                self._text = text
            case natnet.Connect():
                self._counts[natnet.ServerInfo] += 1
            case natnet.BareMessage(natnet.MessageKind.REQUEST_MODELDEF):
                self._counts[natnet.ModelDef] += 1
            case natnet.EchoRequest(client):
                self._echoes.append(client)
            case _:
                pass

    def close(self, message: natnet.ServerMessage) -> bool:
        """Close the request that a message answers.

        Returns:
            False if the message answers no request, but is of a kind that needs one.
        """
        match message:
            case natnet.ServerInfo() | natnet.ModelDef():
                is_asked = self._counts[type(message)] > 0
                self._counts[type(message)] -= 1 if is_asked else 0
            case natnet.EchoResponse(client):
                is_asked = client in self._echoes
                if is_asked:
                    self._echoes.remove(client)
            case _:
                is_asked = True
        return is_asked

    def take_text(self) -> str | None:
        """Return the last text request and close it. None if no text request is open."""
        request = self._text
        self._text = None
        return request


class NatNetStream:
    """The information that an OptiTrack server has sent so far, and its newest frame.

    Pass each datagram to `feed`, which never raises. Times are in ns on the host's clock.

    Args:
        robots: The robots, with their rigid bodies.
        placement: Converts the server's coordinates to the spec's.
        pinned: The version that CONNECT requested in unicast. None if it requested none.
        up: The vertical axis that the spec states. None if it states none.

    Attributes:
        up_axis_answer: The server's answer to `UpAxis`.
        unit_mm: The server's unit of length [mm].
        models_changed: Whether bodies have changed since the last MODELDEF.
        is_changing: Whether the newest frame reports a change.
        streamed_ids: Ids of the bodies in the newest frame.
        last_unread_frame: The newest frame that could not be read.
    """

    def __init__(
        self,
        robots: Sequence[TrackedRobot],
        placement: Placement,
        pinned: natnet.Version | None = None,
        up: UpAxis | None = None,
    ) -> None:
        self.robots = tuple(robots)
        self.counts = StreamCounts()
        self.info: natnet.ServerInfo | None = None
        self.version: natnet.Version | None = None
        """The protocol version of the server's frames. None before SERVERINFO has arrived."""
        self.up_axis = up
        self.up_axis_answer: int | None = None
        self.unit_mm: float | None = None
        self.model: natnet.ModelDef | None = None
        self.models_changed = False
        self.is_changing = False
        self.streamed_ids: tuple[int, ...] = ()
        self.last_unread_frame = b""
        self.clock_sync: ClockSync | None = None
        self.newest: CameraFrame | None = None
        self._placement = placement
        self._requested_version = pinned
        self._ids: dict[str, int] = {}  # the bodies of the model
        self._requests = OpenRequests()
        self._fault = ""
        self._implausible_times = 0  # number of successive frames with an impossible time
        self._duplicate_fault = ""  # fault text if two bodies have one name, otherwise ""

    def find_id(self, body: str | int) -> int | None:
        """Find the id that a rigid body has in frames.

        Args:
            body: Name or id of the body.

        Returns:
            The id. None if the name is unknown.
        """
        if isinstance(body, int):
            return body
        return self._ids.get(body)

    def list_missing_bodies(self) -> list[str | int]:
        """Return the robots' bodies that are not in the newest frame, in the robots' order."""
        return [
            robot.body for robot in self.robots if self.find_id(robot.body) not in self.streamed_ids
        ]

    def record_request(self, message: natnet.ClientMessage) -> None:
        """Record a request that was sent to the server.

        Answers are accepted only if their request was recorded.
        """
        self._requests.add(message)

    def feed(self, datagram: bytes, received_ns: int) -> natnet.ServerMessage | None:
        """Process one datagram, and return its message.

        The result is None if the datagram could not be read or was not requested. It is then
        counted in `counts`.

        Args:
            datagram: The whole datagram.
            received_ns: When it was received, on the host's clock [ns].
        """
        try:
            message = parse_datagram(datagram, self.version)
            if not self._requests.close(message):
                self.counts.unrequested += 1
                return None
            self._process(message, received_ns)
        except WireError:
            self._count_unread(datagram)
            return None
        return message

    def _count_unread(self, datagram: bytes) -> None:
        """Count a datagram that could not be read. Frames before SERVERINFO are not counted."""
        message_kind = int.from_bytes(datagram[:2], "little")
        if self.info is None and message_kind in (
            natnet.MessageKind.FRAME,
            natnet.MessageKind.MODELDEF,
        ):
            return  # the version is not known yet
        self.counts.unread += 1
        if message_kind == natnet.MessageKind.FRAME:
            self.counts.unread_frames += 1
            self.last_unread_frame = datagram
        elif message_kind == natnet.MessageKind.MODELDEF:
            self.counts.unread_models += 1

    def _process(self, message: natnet.ServerMessage, received_ns: int) -> None:
        """Store the information in a message that the server has sent."""
        match message:
            case natnet.NatNetFrame():
                self._process_frame(message, received_ns)
            case natnet.ServerInfo() if self.info is None:
                self.clock_sync = ClockSync(message.clock_hz) if message.clock_hz else None
                self.info = message
                self.version = self._requested_version or message.version
            case natnet.ModelDef():
                self._ids = message.ids()
                self.model = message
                self.models_changed = False
                self._duplicate_fault = self._find_duplicate_names(message)
            case natnet.EchoResponse(client, server) if self.clock_sync is not None:
                self.clock_sync.add(client, received_ns, server)
                self._fault = self._fault or self.clock_sync.fault
            case natnet.Response():
                self._process_response(message)
            case _:
                pass

    def _process_response(self, response: natnet.Response) -> None:
        """Store the answer to the last text request: the vertical axis, or the unit of length."""
        request = self._requests.take_text()
        if request == UP_AXIS_SETTING and self.up_axis is None:
            self.up_axis_answer = int(read_number(response, "i"))
            if self.up_axis_answer in (UpAxis.Y, UpAxis.Z):
                self.up_axis = UpAxis(self.up_axis_answer)
        elif request == UNITS_SETTING:
            unit_mm = read_number(response, "f")
            if not 1e-3 <= unit_mm <= 1e6:
                raise WireError(f"a unit of length of {unit_mm:g} mm is implausible")
            self.unit_mm = unit_mm
            if abs(unit_mm - 1000.0) > 1.0:
                self._fault = self._fault or (
                    f"the camera server streams lengths in units of {unit_mm:g} mm instead "
                    "of metres"
                )

    def _process_frame(self, frame: natnet.NatNetFrame, received_ns: int) -> None:
        """Store a frame as the newest one, unless it was overtaken by a newer frame."""
        sampled_ns = self._find_exposure(frame, received_ns)
        previous = self.newest
        if previous is not None and frame.number <= previous.number:
            if sampled_ns < previous.sampled_ns or frame.number >= previous.number - 10:
                return  # it was overtaken on its way; without a clock, by few
            self._fault = (
                f"the frame counter went back from {previous.number} to {frame.number}: "
                "the server was restarted, or plays a recording"
            )
        self.counts.frames += 1
        self.models_changed |= frame.models_changed
        self.is_changing = frame.models_changed
        self.streamed_ids = tuple(body.id for body in frame.bodies)
        self.newest = self._build_camera_frame(frame, sampled_ns, received_ns)

    def _find_exposure(self, frame: natnet.NatNetFrame, received_ns: int) -> int:
        """Convert a frame's time of exposure to the host's clock [ns].

        If the server's clock is unknown or wrong, the result is the time of reception. Raises
        WireError for the first few frames in a row that have an implausible time.
        """
        if frame.exposure is None or self.clock_sync is None or not self.clock_sync.is_synced:
            return received_ns
        sampled_ns = self.clock_sync.to_host(frame.exposure)
        age_ns = received_ns - sampled_ns
        if -self.clock_sync.error_ns(received_ns) <= age_ns <= AGE_MAX_NS:
            self._implausible_times = 0
            return min(received_ns, sampled_ns)
        self._implausible_times += 1
        age_text = f"{abs(age_ns) / SECOND:.3f} s {'before' if age_ns > 0 else 'after'} reception"
        if self._implausible_times < 5:  # a damaged frame, not yet a wrong clock
            raise WireError(
                f"the time stamp of a frame is not plausible: it was exposed {age_text}"
            )
        self._fault = self._fault or (
            f"according to the camera server's clock, frames were exposed {age_text}: the clock "
            "was set, or runs at a wrong rate"
        )
        return received_ns

    def _find_duplicate_names(self, model: natnet.ModelDef) -> str:
        """Return a message if two bodies have the same name as one robot's body, otherwise ""."""
        for robot in self.robots:
            ids = [body_id for name, body_id in model.bodies if name == robot.body]
            if len(ids) > 1:
                id_list = " and ".join(map(str, ids))
                return (
                    f"the camera server has {len(ids)} rigid bodies named '{robot.body}', with "
                    f"the ids {id_list}: give each its own name in Motive"
                )
        return ""

    def _build_camera_frame(
        self, frame: natnet.NatNetFrame, sampled_ns: int, received_ns: int
    ) -> CameraFrame:
        poses: list[Pose | None] = []
        unknown_bodies = list(frame.bodies)
        duplicate_fault = self._duplicate_fault
        for robot in self.robots:
            body_id = self.find_id(robot.body)
            matching_bodies = [body for body in frame.bodies if body.id == body_id]
            unknown_bodies = [body for body in unknown_bodies if body.id != body_id]
            if len(matching_bodies) > 1:
                duplicate_fault = (
                    duplicate_fault
                    or f"a camera frame has {len(matching_bodies)} rigid bodies with the id "
                    f"{body_id}: give each its own id in Motive"
                )
            if len(matching_bodies) != 1 or self.up_axis is None:
                poses.append(None)
            else:
                poses.append(
                    self._placement.pose(matching_bodies[0], self.up_axis, robot.heading_offset)
                )
        unknown_poses = [
            self._placement.pose(body, self.up_axis) for body in unknown_bodies if self.up_axis
        ]
        return CameraFrame(
            number=frame.number,
            sampled_ns=sampled_ns,
            received_ns=received_ns,
            poses=tuple(poses),
            unknown_objects=tuple(pose for pose in unknown_poses if pose is not None),
            fault=self._fault or (EDIT_MODE if frame.is_edit_mode else "") or duplicate_fault,
        )
