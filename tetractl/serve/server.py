"""A WebSocket on the loopback address from which Foxglove and Lichtblick read a trial.

The protocol and its threads are foxglove-sdk's (the extra `serve`). Topics, schemas and messages
are those of a log. Nobody waits for a client: each has a queue of `BACKLOG` messages, of which the
oldest are dropped. A client can publish nothing and call nothing; it can play a recording.
"""

import logging
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self

from foxglove import Channel, Context, Schema, start_server
from foxglove.websocket import (
    Capability,
    ChannelView,
    Client,
    PlaybackCommand,
    PlaybackControlRequest,
    PlaybackState,
    PlaybackStatus,
    ServerListener,
    WebSocketServer,
)
from google.protobuf.message import Message
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_protobuf.schema import build_file_descriptor_set

from tetractl.core.errors import UsageError
from tetractl.log.format.channels import CHANNELS, LOG, Entry
from tetractl.replay.player import Playback

ADDRESS = "127.0.0.1"
BACKLOG = 2048
"""Messages that may wait for one client: three seconds of a trial with a camera of 120 Hz."""
CLOSE_S = 0.5
"""For the clients to take their last messages; foxglove-sdk would wait for ever."""

_STATUS = {
    Playback.PLAYING: PlaybackStatus.Playing,
    Playback.PAUSED: PlaybackStatus.Paused,
    Playback.ENDED: PlaybackStatus.Ended,
}


@dataclass(frozen=True, slots=True)
class Request:
    """What a viewer asks of the playback: to play or pause, the rate, the time to go to [Unix ns].

    `rate` is in seconds of the trial per second; `seek_ns` is None where the time is to stay.
    """

    playing: bool
    rate: float
    seek_ns: int | None


@dataclass(frozen=True, slots=True)
class State:
    """The state of a playback at a time [Unix ns]; `sought` where the time has jumped there."""

    playback: Playback
    time_ns: int
    rate: float
    sought: bool = False


class ViewerServer:
    """Serves at `url` from construction to `close`; a context manager.

    A recording has the span `span_ns` [Unix ns]; `asked` is called, in another thread, with each
    request of a viewer and returns the state that follows from it. Raises UsageError where the port
    cannot be used; port 0 is any that is free.
    """

    def __init__(
        self,
        name: str,
        port: int,
        span_ns: tuple[int, int] | None = None,
        asked: Callable[[Request], State] | None = None,
    ) -> None:
        logging.getLogger("foxglove").addHandler(logging.NullHandler())  # or it prints to stderr
        self._context = Context()
        self._channels = {
            topic: Channel(
                topic,
                message_encoding=MessageEncoding.Protobuf,
                schema=_schema(message),
                context=self._context,
            )
            for topic, message in CHANNELS.items()
        }
        self._newest: dict[str, Entry] = {}
        self._time_ns = 0  # until there is any
        self._state: State | None = None
        self._server: WebSocketServer | None = None  # a client may come before it is assigned
        try:
            self._server = start_server(
                name=name,
                host=ADDRESS,
                port=port,
                capabilities=[Capability.Time],
                server_listener=_Listener(self._join, asked),
                context=self._context,
                playback_time_range=span_ns,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            raise UsageError(f"port {port}: cannot be used: {error}", "try --port 0") from error
        self.port = self._server.port
        self.url = f"ws://{ADDRESS}:{self.port}"

    @property
    def watched(self) -> bool:
        """Whether any client reads any topic."""
        return any(channel.has_sinks() for channel in self._channels.values())

    def publish(self, entries: Iterable[Entry]) -> None:
        """Send messages, each after the time at which it was logged; never waits."""
        for entry in entries:
            self._newest[entry.topic] = entry
            if entry.log_ns > self._time_ns:
                self._tell_time(entry.log_ns)
            self._channels[entry.topic].log(entry.data, log_time=entry.log_ns)

    def jump(self, time_ns: int, entries: Iterable[Entry]) -> None:
        """Go to another time [Unix ns]; `entries` are the newest messages of all topics then."""
        self._newest.clear()
        self._tell_time(time_ns)
        self.publish(entries)

    def tell(self, state: State) -> None:
        """Send the state of the playback."""
        self._state = state
        if self._server:
            self._server.broadcast_playback_state(_playback_state(state))

    def close(self) -> None:
        """End the connections; waits for at most `CLOSE_S`."""
        if self._server:
            stopping = threading.Thread(target=self._server.stop, name="viewers", daemon=True)
            stopping.start()
            stopping.join(CLOSE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _tell_time(self, time_ns: int) -> None:
        self._time_ns = time_ns
        if self._server:
            self._server.broadcast_time(time_ns)

    def _join(self, topic: str) -> None:
        """Send the time and the newest message of a topic again, for a client that comes late.

        They go to all its readers, to whom they say nothing new; a line of text would.
        """
        if not self._server or not self._time_ns:
            return
        self._server.broadcast_time(self._time_ns)
        if self._state:
            now = replace(self._state, time_ns=self._time_ns, sought=False)
            self._server.broadcast_playback_state(_playback_state(now))
        newest = self._newest.get(topic)
        if newest and topic != LOG:
            self._channels[topic].log(newest.data, log_time=newest.log_ns)


class _Listener(ServerListener):
    """What foxglove-sdk calls, in threads of its own."""

    def __init__(
        self, join: Callable[[str], None], asked: Callable[[Request], State] | None
    ) -> None:
        self._join, self._asked = join, asked

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._join(channel.topic)

    def on_playback_control_request(
        self, playback_control_request: PlaybackControlRequest
    ) -> PlaybackState | None:
        if self._asked is None:
            return None
        asked = playback_control_request
        playing = asked.playback_command == PlaybackCommand.Play
        request = Request(playing, asked.playback_speed, asked.seek_time)
        return _playback_state(self._asked(request))


def _playback_state(state: State) -> PlaybackState:
    return PlaybackState(
        status=_STATUS[state.playback],
        current_time=state.time_ns,
        playback_speed=state.rate,
        did_seek=state.sought,
        request_id=None,
    )


def _schema(message: type[Message]) -> Schema:
    """Return a message's schema as a log holds it."""
    return Schema(
        name=message.DESCRIPTOR.full_name,
        encoding=SchemaEncoding.Protobuf,
        data=build_file_descriptor_set(message).SerializeToString(),
    )
