"""A WebSocket on the loopback address from which Foxglove and Lichtblick read a trial.

The sockets are those of `websockets` (the extra `serve`), in a thread of its own. Nobody waits for
a client: each has a queue of `BACKLOG` messages, of which the oldest are dropped. Only the link
with the token is answered. A client can publish nothing and call nothing; it can play a recording.
"""

import asyncio
import json
import logging
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from http import HTTPStatus
from types import TracebackType
from typing import Any, Self

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as Upgrade
from websockets.http11 import Response
from websockets.typing import Subprotocol

from tetractl.core.errors import UsageError
from tetractl.log.format.channels import LOG, Entry
from tetractl.serve import protocol
from tetractl.serve.door import ADDRESS, is_own_host, is_token, is_viewers_origin, new_token
from tetractl.serve.protocol import Request, State

BACKLOG = 2048
"""Messages that may wait for one client: three seconds of a trial with a camera of 120 Hz."""
CLOSE_S = 0.25
"""For the clients to take their last messages, and again to end their connections."""
REQUEST_BYTES = 1 << 16


class ViewerServer:
    """Serves at `url` from construction to `close`; a context manager.

    A recording has the span `span_ns` [Unix ns]; `asked` is called, in another thread, with each
    request of a viewer and returns the state that follows from it. `viewer` is the address of a
    viewer whose page may read it, beside those that `is_viewers_origin` knows. Raises UsageError
    where the port cannot be used; port 0 is any that is free.
    """

    def __init__(
        self,
        name: str,
        port: int,
        span_ns: tuple[int, int] | None = None,
        asked: Callable[[Request], State] | None = None,
        viewer: str = "",
    ) -> None:
        try:
            listening = socket.create_server((ADDRESS, port))
        except OSError as error:
            why = f"port {port}: cannot be used: {error.strerror}"
            raise UsageError(why, "try --port 0") from error
        self.port: int = listening.getsockname()[1]
        self._token, self._viewer = new_token(), viewer
        self.url = f"ws://{ADDRESS}:{self.port}/{self._token}"
        self.watched = False
        """Whether any client reads any topic."""
        self._asked = asked
        self._greeting = protocol.greeting(name, span_ns)
        # From here on all is of the thread, to which the methods below hand what is to be done.
        self._clients: set[_Client] = set()
        self._newest: dict[str, Entry] = {}
        self._time_ns = 0  # until there is any
        self._state: State | None = None
        self._loop, self._closing = asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(
            target=self._run, args=(listening,), name="viewers", daemon=True
        )
        self._thread.start()

    def publish(self, entries: Iterable[Entry]) -> None:
        """Send messages, each after the time at which it was logged; never waits."""
        self._do(self._publish, list(entries))

    def jump(self, time_ns: int, entries: Iterable[Entry]) -> None:
        """Go to another time [Unix ns]; `entries` are the newest messages of all topics then."""
        self._do(self._jump, time_ns, list(entries))

    def tell(self, state: State) -> None:
        """Send the state of the playback."""
        self._do(self._tell, state)

    def close(self) -> None:
        """End the connections; waits for at most twice `CLOSE_S`."""
        self._do(self._closing.set)
        self._thread.join(2 * CLOSE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _do(self, action: Callable[..., object], *args: object) -> None:
        with suppress(RuntimeError):  # it is closed
            self._loop.call_soon_threadsafe(action, *args)

    def _run(self, listening: socket.socket) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve(listening))

    async def _serve(self, listening: socket.socket) -> None:
        logger = logging.getLogger(__name__)
        logger.addHandler(logging.NullHandler())  # or what clients do wrong is printed to stderr
        async with serve(
            self._meet,
            sock=listening,
            process_request=self._admit,
            subprotocols=[Subprotocol(protocol.PROTOCOL)],
            compression=None,
            server_header=None,
            max_size=REQUEST_BYTES,
            close_timeout=CLOSE_S,
            logger=logger,
        ):
            await self._closing.wait()
            last = [asyncio.create_task(client.sent.wait()) for client in self._clients]
            if last:
                await asyncio.wait(last, timeout=CLOSE_S)

    def _admit(self, connection: ServerConnection, upgrade: Upgrade) -> Response | None:
        """Return None for a request that may become a connection, else the answer."""
        headers = upgrade.headers
        if (
            is_token(upgrade.path.strip("/"), self._token)
            and is_own_host(headers.get("Host"), self.port)
            and is_viewers_origin(headers.get("Origin"), self._viewer)
        ):
            return None
        return connection.respond(HTTPStatus.FORBIDDEN, "use the link that tetractl printed\n")

    async def _meet(self, connection: ServerConnection) -> None:
        """Serve one client; what it says wrong ends its connection and no other."""
        for said in self._greeting:
            await connection.send(said)
        client = _Client()
        if self._time_ns:
            client.put(protocol.time(self._time_ns))
        if self._state:
            now = replace(self._state, time_ns=self._time_ns, sought=False)
            client.put(protocol.playback_state(now))
        self._clients.add(client)
        sending = asyncio.create_task(client.send(connection))
        try:
            async for said in connection:
                self._obey(client, said)
        finally:
            sending.cancel()
            client.sent.set()
            self._clients.discard(client)
            self._count()

    def _obey(self, client: "_Client", said: str | bytes) -> None:
        if isinstance(said, bytes):
            found = protocol.control(said)
            if found and self._asked:
                request, name = found
                client.put(protocol.playback_state(self._asked(request), name))
            return
        asked: dict[str, Any] = json.loads(said)
        if asked["op"] == "subscribe":
            for one in asked["subscriptions"]:
                topic = protocol.TOPICS[one["channelId"]]
                client.subscriptions[topic] = protocol.subscription(one["id"])
                if topic in self._newest and topic != LOG:  # a line of text would be shown twice
                    client.message(self._newest[topic])
        elif asked["op"] == "unsubscribe":
            ended = set(map(protocol.subscription, asked["subscriptionIds"]))
            kept = client.subscriptions.items()
            client.subscriptions = {topic: one for topic, one in kept if one not in ended}
        self._count()

    def _count(self) -> None:
        self.watched = any(client.subscriptions for client in self._clients)

    def _publish(self, entries: Iterable[Entry]) -> None:
        for entry in entries:
            self._newest[entry.topic] = entry
            if entry.log_ns > self._time_ns:
                self._go_to(entry.log_ns)
            for client in self._clients:
                client.message(entry)

    def _jump(self, time_ns: int, entries: Iterable[Entry]) -> None:
        self._newest.clear()
        self._go_to(time_ns)
        self._publish(entries)

    def _go_to(self, time_ns: int) -> None:
        self._time_ns = time_ns
        self._send(protocol.time(time_ns))

    def _tell(self, state: State) -> None:
        self._state = state
        self._send(protocol.playback_state(state))

    def _send(self, message: bytes) -> None:
        for client in self._clients:
            client.put(message)


class _Client:
    """The subscriptions of one client, an id by topic, and the messages that wait for it."""

    def __init__(self) -> None:
        self.subscriptions: dict[str, bytes] = {}
        self.sent = asyncio.Event()  # nothing waits
        self._some = asyncio.Event()
        self._waiting: deque[bytes] = deque(maxlen=BACKLOG)

    def message(self, entry: Entry) -> None:
        """Have a message sent where its topic is subscribed to."""
        subscription = self.subscriptions.get(entry.topic)
        if subscription:
            self.put(protocol.message(subscription, entry))

    def put(self, message: bytes) -> None:
        """Have a message sent."""
        self._waiting.append(message)
        self._some.set()
        self.sent.clear()

    async def send(self, connection: ServerConnection) -> None:
        """Send what waits, until the connection ends."""
        with suppress(ConnectionClosed):
            while True:
                await self._some.wait()
                while self._waiting:
                    await connection.send(self._waiting.popleft())
                self._some.clear()
                self.sent.set()
