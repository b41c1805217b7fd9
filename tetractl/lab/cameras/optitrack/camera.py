"""OptiTrack cameras as a `Camera`: a NatNet connection, and what is checked before a run."""

from collections.abc import Callable
from types import TracebackType
from typing import Self

from tetractl.core.clock import Clock
from tetractl.core.commands import EMULATED_NAME, Health
from tetractl.core.poses import CameraFrame
from tetractl.core.setup import Setup
from tetractl.lab.cameras.optitrack import diagnosis
from tetractl.lab.cameras.optitrack.client import NatNetClient
from tetractl.lab.cameras.optitrack.section import OptitrackSection
from tetractl.lab.cameras.optitrack.stream import Stream, Tracked


class OptitrackCamera:
    """Tracks the setup's robots by their rigid bodies; see `tetractl.core.protocols.Camera`."""

    def __init__(
        self,
        section: OptitrackSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        robots = [section.robot(name) for name in setup.names]
        self.names = setup.names
        tracked = [Tracked(robot.body, robot.heading_offset) for robot in robots]
        self.section = section
        self.client = NatNetClient(section, tracked, setup.metres, clock, wake)

    def __enter__(self) -> Self:
        """Connect: return once frames stream and the clocks, axes and names are known.

        AbortError says which of these did not come, what came in its place, and what to set.
        """
        try:
            self.client.open()
            self.client.wait_connected(self.section.connect)
        except BaseException:
            self.client.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.client.close()

    @property
    def stream(self) -> Stream:
        """What is known of the server."""
        return self.client.stream

    @property
    def newest(self) -> CameraFrame | None:
        """The newest frame, None before the first."""
        return self.client.newest

    @property
    def damaged(self) -> int:
        """Datagrams dropped so far because they could not be read."""
        return self.stream.counts.bad

    def frames(self) -> list[CameraFrame]:
        """Return, once, every frame since the last call, oldest first."""
        return self.client.drain()

    def check(self) -> Health:
        """Return which rigid bodies are not streamed, and what is known of server and clock."""
        stream, sync = self.stream, self.stream.sync
        problems = diagnosis.not_streamed(stream, self.names)
        warnings = diagnosis.not_taken(self.client.senders, stream)
        round_trip = "unknown"
        if sync is not None and sync.synced:
            round_trip = f"{sync.round_trip_ns / 1e6:.3f}"
        else:
            warnings.append("the server does not tell its clock, so the frames' age is not known")
        if stream.unit_mm is None:
            warnings.append("the server does not report its unit of length: metres are assumed")
        version = stream.version
        if version is not None and not version.known:
            warnings.append(f"protocol {version} is newer than those known here; it is read as 4.3")
        server = stream.info.name if stream.info else ""
        facts = {
            "natnet": str(version),
            "server": server,
            "rigid_bodies": diagnosis.bodies(stream),
            "clock_round_trip_ms": round_trip,
        }
        return Health(tuple(problems), tuple(warnings), facts, emulated=EMULATED_NAME in server)
