"""Streams running trials to the log viewers Foxglove and Lichtblick, over WebSockets.

`websockets` (the extra `serve`) implements each connection. No trial waits for a viewer: each has a
queue of at most `BACKLOG` messages and a thread that sends them; when the queue is full, the oldest
are dropped. A viewer cannot publish messages or call services.
"""

import json
import socket
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from time import monotonic
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.sync.connection import Connection

from tetractl.core.clock import Clock
from tetractl.core.poses import Sample
from tetractl.core.trial import Start
from tetractl.log.format.channels import LOG, Entry, Record
from tetractl.log.write.encoder import Encoder, RecordSink
from tetractl.serve import foxglove_protocol

BACKLOG = 2048
"""Length of a viewer's queue [messages]: three seconds of a trial with a camera of 120 Hz."""
CLOSE_S = 0.5
"""Time for the viewers to receive their last messages and to end their connections [s]."""


class Viewers(RecordSink):
    """All connected viewers of a run; its trials are sent to them under the name `name`."""

    def __init__(self, name: str) -> None:
        self._greeting = foxglove_protocol.greeting(name)
        # lock of the fields below; never held while waiting for a viewer
        self._lock = threading.Lock()
        self._clients: set[_Client] = set()
        self._newest: dict[str, Entry] = {}
        self._time_ns = 0  # log time of the last message, 0 before the first

    @property
    def watched(self) -> bool:
        """Whether any viewer has subscribed to a topic."""
        with self._lock:
            return any(client.subscriptions for client in self._clients)

    def add(self, record: Record) -> None:
        """Send a message to the viewers, preceded by its log time.

        It never waits, and skips attachments.
        """
        if isinstance(record, Entry):
            with self._lock:
                self._publish(record)

    def jump(self, time_ns: int) -> None:
        """Set the viewers to another time [Unix ns], and forget the newest message of each topic.

        Viewers that subscribe later therefore receive nothing from before the jump.
        """
        with self._lock:
            self._newest.clear()
            self._go_to(time_ns)

    def close(self) -> None:
        """Send the queued messages, and end the connections to all viewers.

        After `CLOSE_S` seconds, connections that are still open are cut.
        """
        with self._lock:
            clients = list(self._clients)
        for client in clients:
            client.end()
        until = monotonic() + CLOSE_S
        for client in clients:
            client.leave(until)

    def converse(self, link: Connection) -> None:
        """Serve one viewer until its connection ends.

        An invalid message ends only this connection.
        """
        client = _Client(link)
        with self._lock:
            for message in self._greeting:
                client.put(message)
            if self._time_ns:
                client.put(foxglove_protocol.time(self._time_ns))
            self._clients.add(client)
        try:
            for request in link:
                self._obey(client, request)
        except Exception:  # a viewer's messages or failure must not end the run
            link.close(CloseCode.INTERNAL_ERROR)
        finally:
            with self._lock:
                self._clients.discard(client)
            client.end()
            client.leave(monotonic())

    def _obey(self, client: "_Client", request: str | bytes) -> None:
        """Carry out a viewer's request: to subscribe, or to end a subscription.

        Other requests are ignored.
        """
        items: dict[str, Any] = json.loads(request)
        with self._lock:
            if items["op"] == "subscribe":
                for item in items["subscriptions"]:
                    self._subscribe(client, item["channelId"], item["id"])
            elif items["op"] == "unsubscribe":
                for number in items["subscriptionIds"]:
                    client.unsubscribe(foxglove_protocol.subscription(number))

    def _subscribe(self, client: "_Client", channel: int, number: int) -> None:
        """Subscribe a viewer to a topic, and send it the newest message of the topic at once.

        The newest operator message is not sent, because the viewer would show it twice.
        """
        topic = foxglove_protocol.TOPICS[channel]
        client.subscriptions[topic] = foxglove_protocol.subscription(number)
        # otherwise a viewer would show an operator message twice
        if topic in self._newest and topic != LOG:
            client.message(self._newest[topic])

    def _publish(self, entry: Entry) -> None:
        """Send a message to the viewers. The caller holds the lock.

        If the message is later than the time that the viewers show, they receive its log
        time first.
        """
        self._newest[entry.topic] = entry
        if entry.log_ns > self._time_ns:
            self._go_to(entry.log_ns)
        for client in self._clients:
            client.message(entry)

    def _go_to(self, time_ns: int) -> None:
        """Set the time that the viewers show [Unix ns]. The caller holds the lock."""
        self._time_ns = time_ns
        message = foxglove_protocol.time(time_ns)
        for client in self._clients:
            client.put(message)


class _Client:
    """One viewer: its subscriptions, an id per topic, and the messages that wait to be sent."""

    def __init__(self, link: Connection) -> None:
        self.subscriptions: dict[str, bytes] = {}
        self._link = link
        self._changed = threading.Condition()  # guards the two fields below
        self._waiting: deque[str | bytes] = deque(maxlen=BACKLOG)
        self._ending = False
        self._sender = threading.Thread(target=self._send, name="viewer", daemon=True)
        self._sender.start()

    def message(self, entry: Entry) -> None:
        """Queue a message for this viewer if it has subscribed to the message's topic."""
        subscription = self.subscriptions.get(entry.topic)
        if subscription is not None:
            self.put(foxglove_protocol.message(subscription, entry))

    def unsubscribe(self, subscription: bytes) -> None:
        """End the subscription with this id. An unknown id is ignored."""
        for topic, number in list(self.subscriptions.items()):
            if number == subscription:
                del self.subscriptions[topic]

    def put(self, message: str | bytes) -> None:
        """Queue a message for this viewer. If BACKLOG messages already wait, drop the oldest."""
        with self._changed:
            self._waiting.append(message)
            self._changed.notify()

    def end(self) -> None:
        """Close the connection once all queued messages are sent."""
        with self._changed:
            self._ending = True
            self._changed.notify()

    def leave(self, until: float) -> None:
        """Wait until the connection has ended, at most until a time of `monotonic`; then cut it."""
        self._sender.join(max(until - monotonic(), 0))
        with suppress(OSError):
            self._link.socket.shutdown(socket.SHUT_RDWR)
        self._sender.join()

    def _send(self) -> None:
        """Send queued messages until the end, then close the connection.

        A thread of its own runs this.
        """
        with suppress(OSError, ConnectionClosed):
            message = self._next()
            while message is not None:
                self._link.send(message)
                message = self._next()
            self._link.close()

    def _next(self) -> str | bytes | None:
        """Wait for the next queued message, and remove it from the queue.

        Messages that still wait after `end` are returned first. The result is None if the
        connection ends and the queue is empty.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._ending)
            return self._waiting.popleft() if self._waiting else None


class ServedRun(Encoder):
    """An observer of trials that sends viewers the same messages as a log would contain.

    A trial in virtual time is slowed down to the wall clock `wall`, so that people can watch it.
    """

    def __init__(self, viewers: Viewers, wall: Clock) -> None:
        super().__init__(viewers, real_time=True)
        self._viewers = viewers
        self._wall = wall

    def on_start(self, start: Start) -> None:
        """Send the scene of a new trial to the viewers, and set their time to its start."""
        self._paced = start.plant.virtual
        self._began_ns = self._wall.now()
        self._viewers.jump(start.start_unix_ns)
        super().on_start(start)

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Send camera frames to the connected viewers.

        If no viewer watches, only the newest frame is kept, for viewers that connect later.
        """
        wanted = samples if self._viewers.watched else samples[-1:]
        for sample in wanted:
            if self._paced:
                self._wall.sleep_until(self._began_ns + sample.observation.received_ns)
            super().on_samples([sample])
