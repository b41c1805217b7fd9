"""Serves a recorded trial, or running trials, to the log viewers Foxglove and Lichtblick.

`websockets` (the extra `serve`) implements each connection, and its server's handshake. No trial
waits for a viewer: each viewer has a queue of at most `BACKLOG` messages and a thread that sends
them; when the queue is full, the oldest are dropped. A viewer cannot publish messages or call
services; it can only control the playback of a recording.
"""

import json
import logging
import queue
import socket
import threading
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from time import monotonic
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request as Upgrade
from websockets.protocol import State
from websockets.server import ServerProtocol
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Sample
from tetractl.core.trial import Start
from tetractl.log.format.channels import CHANNELS, LOG, Entry
from tetractl.log.read.raw_log import RawLog
from tetractl.log.write.encoder import Encoder
from tetractl.replay.player import Playback, Player
from tetractl.serve import foxglove_protocol
from tetractl.serve.foxglove_protocol import PlaybackState, Request

BACKLOG = 2048
"""Length of a viewer's queue [messages]: three seconds of a trial with a camera of 120 Hz."""
CLOSE_S = 0.5
"""Time for the viewers to receive their last messages and to end their connections [s]."""

_QUIET = logging.getLogger(__name__)
_QUIET.addHandler(logging.NullHandler())  # otherwise errors of viewers are printed to stderr
_QUIET.propagate = False


class Viewers:
    """Sends a trial called `name` to viewers, and receives their requests.

    `span_ns` [Unix ns] is the span of a recording, None for running trials. `asked` is called with
    each request of a viewer, in another thread, and returns the new state of the playback.
    """

    def __init__(
        self,
        name: str,
        span_ns: tuple[int, int] | None = None,
        asked: Callable[[Request], PlaybackState] | None = None,
    ) -> None:
        self._asked = asked
        self._greeting = foxglove_protocol.greeting(name, span_ns)
        # lock of the fields below; never held while waiting for a viewer
        self._lock = threading.Lock()
        self._clients: set[_Client] = set()
        self._newest: dict[str, Entry] = {}
        self._time_ns = 0  # log time of the last message, 0 before the first
        self._state: PlaybackState | None = None

    @property
    def watched(self) -> bool:
        """Whether a viewer has subscribed to a topic."""
        with self._lock:
            return any(client.subscriptions for client in self._clients)

    def messages(self, entries: Iterable[Entry]) -> None:
        """Send messages, each preceded by its log time; never waits."""
        with self._lock:
            for entry in entries:
                self._publish(entry)

    def attachment(self, name: str, media_type: str, unix_ns: int, data: bytes) -> None:
        """Do nothing: viewers have the spec's facts from the scene."""

    def flush(self) -> None:
        """Do nothing: messages are sent at once."""

    def jump(self, time_ns: int, entries: Iterable[Entry]) -> None:
        """Jump to another time [Unix ns]; `entries` are the newest message of each topic at that
        time."""
        with self._lock:
            self._newest.clear()
            self._go_to(time_ns)
            for entry in entries:
                self._publish(entry)

    def announce(self, state: PlaybackState) -> None:
        """Send the state of the playback."""
        with self._lock:
            self._state = state
            self._put(foxglove_protocol.playback_state(state))

    def close(self) -> None:
        """End the connections; waits for at most `CLOSE_S`."""
        with self._lock:
            clients = list(self._clients)
        for client in clients:
            client.end()
        until = monotonic() + CLOSE_S
        for client in clients:
            client.leave(until)

    def converse(self, connection: socket.socket, request: bytes) -> None:
        """Serve a viewer whose HTTP request was read already, until its connection ends. An invalid
        message ends only its own connection.
        """
        link = _upgraded(connection, request)
        if link is None:
            return
        client = _Client(link)
        with self._lock:
            for said in self._greeting:
                client.put(said)
            if self._time_ns:
                client.put(foxglove_protocol.time(self._time_ns))
            if self._state:
                now = replace(self._state, time_ns=self._time_ns, sought=False)
                client.put(foxglove_protocol.playback_state(now))
            self._clients.add(client)
        try:
            for said in link:
                self._obey(client, said)
        except Exception:  # a viewer's messages or failure must not end the run
            link.close(CloseCode.INTERNAL_ERROR)
        finally:
            with self._lock:
                self._clients.discard(client)
            client.end()
            client.leave(monotonic())

    def _obey(self, client: "_Client", said: str | bytes) -> None:
        if isinstance(said, bytes):
            found = foxglove_protocol.control(said)
            if found and self._asked:
                request, name = found
                client.put(foxglove_protocol.playback_state(self._asked(request), name))
            return
        asked: dict[str, Any] = json.loads(said)
        with self._lock:
            if asked["op"] == "subscribe":
                for one in asked["subscriptions"]:
                    topic = foxglove_protocol.TOPICS[one["channelId"]]
                    client.subscriptions[topic] = foxglove_protocol.subscription(one["id"])
                    # otherwise a viewer would show an operator message twice
                    if topic in self._newest and topic != LOG:
                        client.message(self._newest[topic])
            elif asked["op"] == "unsubscribe":
                ended = set(map(foxglove_protocol.subscription, asked["subscriptionIds"]))
                kept = client.subscriptions.items()
                client.subscriptions = {topic: one for topic, one in kept if one not in ended}

    def _publish(self, entry: Entry) -> None:
        self._newest[entry.topic] = entry
        if entry.log_ns > self._time_ns:
            self._go_to(entry.log_ns)
        for client in self._clients:
            client.message(entry)

    def _go_to(self, time_ns: int) -> None:
        self._time_ns = time_ns
        self._put(foxglove_protocol.time(time_ns))

    def _put(self, message: bytes) -> None:
        for client in self._clients:
            client.put(message)


def _upgraded(connection: socket.socket, request: bytes) -> Connection | None:
    """Answer a request for a WebSocket; return the WebSocket, None if the request is refused."""
    protocol = ServerProtocol(
        subprotocols=[Subprotocol(foxglove_protocol.PROTOCOL)],
        max_size=1 << 16,
        logger=_QUIET,
    )
    protocol.receive_data(request)
    for event in protocol.events_received():
        if isinstance(event, Upgrade):
            protocol.send_response(protocol.accept(event))
    with suppress(OSError):
        connection.sendall(b"".join(protocol.data_to_send()))
        if protocol.state is State.OPEN:
            return Connection(connection, protocol, ping_interval=None, close_timeout=CLOSE_S / 2)
    return None


class _Client:
    """The subscriptions of one viewer, an id per topic, and its queued messages."""

    def __init__(self, link: Connection) -> None:
        self.subscriptions: dict[str, bytes] = {}
        self._link, self._some = link, threading.Condition()
        self._waiting: deque[str | bytes] = deque(maxlen=BACKLOG)
        self._ending = False
        self._sender = threading.Thread(target=self._send, name="viewer", daemon=True)
        self._sender.start()

    def message(self, entry: Entry) -> None:
        """Queue a message if its topic is subscribed to."""
        if subscription := self.subscriptions.get(entry.topic):
            self.put(foxglove_protocol.message(subscription, entry))

    def put(self, message: str | bytes) -> None:
        """Queue a message; if BACKLOG messages wait already, the oldest is dropped."""
        with self._some:
            self._waiting.append(message)
            self._some.notify()

    def end(self) -> None:
        """Close the connection once all queued messages are sent."""
        with self._some:
            self._ending = True
            self._some.notify()

    def leave(self, until: float) -> None:
        """Wait for the end until a time of `monotonic`, then cut the connection."""
        self._sender.join(max(until - monotonic(), 0))
        with suppress(OSError):
            self._link.socket.shutdown(socket.SHUT_RDWR)
        self._sender.join()

    def _send(self) -> None:
        with suppress(OSError, ConnectionClosed):
            while True:
                with self._some:
                    self._some.wait_for(lambda: self._waiting or self._ending)
                    if not self._waiting:
                        break
                    message = self._waiting.popleft()
                self._link.send(message)
            self._link.close()


class ServedReplay:
    """Sends the messages of a log to `viewers` as the time of `player` passes them.

    After a jump in time the newest message of each topic is sent again. Requests of viewers are
    answered at once and applied by the next `follow`.
    """

    def __init__(self, contents: RawLog, player: Player) -> None:
        self._start_ns = contents.run.start_unix_ns
        known = [entry for entry in contents.entries if entry.topic in CHANNELS]
        self._entries = sorted(known, key=lambda entry: entry.log_ns)
        self._times = [entry.log_ns for entry in self._entries]
        self._requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self.player = player
        self._jumps: int | None = None  # number of the player's jumps at the last call of `follow`
        self._sent = 0  # index of the next entry to send
        self._announced: tuple[Playback, float] | None = None
        span_ns = (self._start_ns + player.start_ns, self._start_ns + player.until_ns)
        name = contents.run.name
        self.viewers = Viewers(name, span_ns, self._asked)

    def follow(self) -> None:
        """Apply the viewers' requests, and send the messages since the last call."""
        player = self.player
        while not self._requests.empty():
            request = self._requests.get()
            at_ns = None if request.seek_ns is None else request.seek_ns - self._start_ns
            player.command(playing=request.playing, rate=request.rate, at_ns=at_ns)
            self._announced = None
        player.update()
        jumped = player.jumps != self._jumps
        now_ns, self._jumps = self._start_ns + player.now, player.jumps
        passed = bisect_right(self._times, now_ns)
        if jumped:
            newest = {entry.topic: entry for entry in self._entries[:passed]}
            self.viewers.jump(now_ns, newest.values())
        else:
            self.viewers.messages(self._entries[self._sent : passed])
        self._sent = passed
        state = player.state, player.rate
        if (jumped or state != self._announced) and player.state is not Playback.QUIT:
            self._announced = state
            self.viewers.announce(PlaybackState(player.state, now_ns, player.rate, jumped))

    def play(self, wall: Clock) -> None:
        """Follow the player until it quits."""
        while self.player.state is not Playback.QUIT:
            self.follow()
            wall.sleep_until(wall.now() + SECOND // 60)

    def _asked(self, request: Request) -> PlaybackState:
        self._requests.put(request)
        time_ns = self._start_ns + self.player.now if request.seek_ns is None else request.seek_ns
        playback = Playback.PLAYING if request.playing else Playback.PAUSED
        return PlaybackState(playback, time_ns, request.rate, request.seek_ns is not None)


class ServedRun(Encoder):
    """Sends the messages that a log would contain, for one trial after another: an `Observer` of
    each trial.

    A trial in virtual time is slowed to the wall clock `wall`, so that people can watch it.
    """

    def __init__(self, viewers: Viewers, wall: Clock) -> None:
        super().__init__(viewers, real_time=True)
        self._viewers, self._wall = viewers, wall

    def on_start(self, start: Start) -> None:
        """Send the scene of a new trial, and set the viewers' time to its start."""
        self._paced = start.plant.virtual
        self._began_ns = self._wall.now()
        self._viewers.jump(start.start_unix_ns, ())
        super().on_start(start)

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Send camera frames; without a viewer, keep only the newest for later viewers."""
        for sample in samples if self._viewers.watched else samples[-1:]:
            if self._paced:
                self._wall.sleep_until(self._began_ns + sample.observation.received_ns)
            super().on_samples([sample])
