"""Stream running trials to the log viewers Foxglove and Lichtblick, over WebSockets.

The package `websockets` (the extra `serve`) implements each connection. No trial waits for a
viewer. Each viewer has a queue of at most BACKLOG_MAX messages, and a thread that sends them. If
the queue is full, the oldest messages are dropped. A viewer cannot publish messages or call
services.
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

BACKLOG_MAX = 2048
"""Maximum length of a viewer's queue [messages]: 3 s of a trial with a camera of 120 Hz."""
CLOSE_S = 0.5
"""Time for the viewers to receive their last messages and to end their connections [s]."""


class Viewers(RecordSink):
    """The connected log viewers of a run, to which its trials are sent.

    Args:
        name: Name of the run, which the viewers show.
    """

    def __init__(self, name: str) -> None:
        self._greeting = foxglove_protocol.build_greeting(name)
        # lock of the fields below; never held while waiting for a viewer
        self._lock = threading.Lock()
        self._viewers: set[_Viewer] = set()
        self._newest: dict[str, Entry] = {}
        self._time_ns = 0  # log time of the last message, 0 before the first

    @property
    def watched(self) -> bool:
        """Whether any viewer has subscribed to a topic."""
        with self._lock:
            return any(viewer.subscriptions for viewer in self._viewers)

    def add(self, record: Record) -> None:
        """Send a record of the log to the viewers, preceded by its log time.

        Attachments are skipped. This method never waits for a viewer.
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
            self._set_time(time_ns)

    def close(self) -> None:
        """Send the queued messages, and end the connections to all viewers.

        After `CLOSE_S` seconds, connections that are still open are cut.
        """
        with self._lock:
            viewers = list(self._viewers)
        for viewer in viewers:
            viewer.end_after_queue()
        deadline_s = monotonic() + CLOSE_S
        for viewer in viewers:
            viewer.wait_until_closed(deadline_s)

    def serve_viewer(self, link: Connection) -> None:
        """Serve one viewer until its connection ends.

        An invalid message ends only this connection.
        """
        viewer = _Viewer(link)
        with self._lock:
            for message in self._greeting:
                viewer.queue(message)
            if self._time_ns:
                viewer.queue(foxglove_protocol.encode_time(self._time_ns))
            self._viewers.add(viewer)
        try:
            for request in link:
                self._handle_request(viewer, request)
        except Exception:  # a viewer's messages or failure must not end the run
            link.close(CloseCode.INTERNAL_ERROR)
        finally:
            with self._lock:
                self._viewers.discard(viewer)
            viewer.end_after_queue()
            viewer.wait_until_closed(monotonic())

    def _handle_request(self, viewer: "_Viewer", request: str | bytes) -> None:
        """Handle a viewer's request to subscribe to topics, or to end subscriptions.

        Other requests are ignored.
        """
        request_fields: dict[str, Any] = json.loads(request)
        with self._lock:
            if request_fields["op"] == "subscribe":
                for subscription_fields in request_fields["subscriptions"]:
                    self._subscribe(
                        viewer, subscription_fields["channelId"], subscription_fields["id"]
                    )
            elif request_fields["op"] == "unsubscribe":
                for subscription_id in request_fields["subscriptionIds"]:
                    viewer.unsubscribe(foxglove_protocol.encode_subscription(subscription_id))

    def _subscribe(self, viewer: "_Viewer", channel: int, subscription_id: int) -> None:
        """Subscribe a viewer to a topic, and send it the newest message of the topic at once.

        The newest operator message is not sent, because the viewer would show it twice.
        """
        topic = foxglove_protocol.TOPICS[channel]
        viewer.subscriptions[topic] = foxglove_protocol.encode_subscription(subscription_id)
        # otherwise a viewer would show an operator message twice
        if topic in self._newest and topic != LOG:
            viewer.queue_entry(self._newest[topic])

    def _publish(self, entry: Entry) -> None:
        """Send a message to the viewers. The caller holds the lock.

        If the message is later than the time that the viewers show, they receive its log
        time first.
        """
        self._newest[entry.topic] = entry
        if entry.log_ns > self._time_ns:
            self._set_time(entry.log_ns)
        for viewer in self._viewers:
            viewer.queue_entry(entry)

    def _set_time(self, time_ns: int) -> None:
        """Set the time that the viewers show [Unix ns]. The caller holds the lock."""
        self._time_ns = time_ns
        message = foxglove_protocol.encode_time(time_ns)
        for viewer in self._viewers:
            viewer.queue(message)


class _Viewer:
    """A connected viewer, with its subscriptions and the messages that wait to be sent to it.

    Attributes:
        subscriptions: The encoded id of each subscription, by topic.
    """

    def __init__(self, link: Connection) -> None:
        self.subscriptions: dict[str, bytes] = {}
        self._link = link
        self._queue_changed = threading.Condition()  # guards the two fields below
        self._queue: deque[str | bytes] = deque(maxlen=BACKLOG_MAX)
        self._is_ending = False
        self._sender = threading.Thread(target=self._send, name="viewer", daemon=True)
        self._sender.start()

    def queue_entry(self, entry: Entry) -> None:
        """Queue a message for this viewer if it has subscribed to the message's topic."""
        subscription = self.subscriptions.get(entry.topic)
        if subscription is not None:
            self.queue(foxglove_protocol.encode_message(subscription, entry))

    def unsubscribe(self, subscription: bytes) -> None:
        """End the subscription with this id. An unknown id is ignored."""
        for topic, number in list(self.subscriptions.items()):
            if number == subscription:
                del self.subscriptions[topic]

    def queue(self, message: str | bytes) -> None:
        """Queue a message for this viewer.

        If BACKLOG_MAX messages already wait, the oldest is dropped.
        """
        with self._queue_changed:
            self._queue.append(message)
            self._queue_changed.notify()

    def end_after_queue(self) -> None:
        """Close the connection once all queued messages are sent."""
        with self._queue_changed:
            self._is_ending = True
            self._queue_changed.notify()

    def wait_until_closed(self, until: float) -> None:
        """Wait until the connection has ended, and cut it after a time.

        Args:
            until: The time at which the connection is cut, on the clock `monotonic` [s].
        """
        self._sender.join(max(until - monotonic(), 0))
        with suppress(OSError):
            self._link.socket.shutdown(socket.SHUT_RDWR)
        self._sender.join()

    def _send(self) -> None:
        """Send queued messages until the end, then close the connection.

        A thread of its own runs this.
        """
        with suppress(OSError, ConnectionClosed):
            message = self._take_next()
            while message is not None:
                self._link.send(message)
                message = self._take_next()
            self._link.close()

    def _take_next(self) -> str | bytes | None:
        """Wait for the next queued message, and remove it from the queue.

        Messages that still wait after `end` are returned first. The result is None if the
        connection ends and the queue is empty.
        """
        with self._queue_changed:
            self._queue_changed.wait_for(lambda: self._queue or self._is_ending)
            return self._queue.popleft() if self._queue else None


class ServedRun(Encoder):
    """An observer of trials that sends viewers the messages that a log would contain.

    Args:
        viewers: The viewers.
        wall: The wall clock. A trial in virtual time is slowed down to this clock, so that people
            can watch it.
    """

    def __init__(self, viewers: Viewers, wall: Clock) -> None:
        super().__init__(viewers, real_time=True)
        self._viewers = viewers
        self._wall_clock = wall

    def on_start(self, start: Start) -> None:
        """Send the scene of a new trial to the viewers, and set their time to its start."""
        self._is_paced = start.plant.virtual
        self._began_ns = self._wall_clock.now()
        self._viewers.jump(start.start_unix_ns)
        super().on_start(start)

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Send camera frames to the connected viewers.

        If no viewer watches, only the newest frame is kept, for viewers that connect later.
        """
        sent_samples = samples if self._viewers.watched else samples[-1:]
        for sample in sent_samples:
            if self._is_paced:
                self._wall_clock.sleep_until(self._began_ns + sample.observation.received_ns)
            super().on_samples([sample])
