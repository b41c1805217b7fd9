"""Records every byte that passes between a run and its devices, in an MCAP file, which
`tetractl.log.format.wire` reads.

Each message is one datagram, or the bytes of one read or write of a port, as they passed. Each
wire has two channels, such as `/natnet/received` and `/natnet/sent`. Times are ns on the run's
clock.
"""

import queue
import threading
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.writer import CompressionType, Writer

from tetractl.core.errors import LogError
from tetractl.core.version import __version__

QUEUE = 100_000  # passages that may wait for the disk


@dataclass(frozen=True, slots=True)
class Passage:
    """What passed: which wire, which way, when [ns], and the bytes."""

    wire: str
    received: bool
    t_ns: int
    data: bytes


class WireRecorder:
    """A `Tap` that records to a file from a thread of its own; a context manager.

    Where the disk refuses or cannot follow, recording ends and `error` says why; the run goes on.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.error: str | None = None
        self._queue: queue.Queue[Passage | None] = queue.Queue(QUEUE)
        self._thread = threading.Thread(target=self._write, name="wire recorder", daemon=True)

    def __enter__(self) -> Self:
        try:
            self._file = self.path.open("xb")
        except OSError as error:
            raise LogError(f"{self.path}: cannot record the wire: {error.strerror}") from error
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._queue.put(None)
        self._thread.join()

    def received(self, wire: str, t_ns: int, data: bytes) -> None:
        """Record what came."""
        self._add(Passage(wire, True, t_ns, data))

    def sent(self, wire: str, t_ns: int, data: bytes) -> None:
        """Record what left."""
        self._add(Passage(wire, False, t_ns, data))

    def _add(self, passage: Passage) -> None:
        if self.error is None:
            try:
                self._queue.put_nowait(passage)
            except queue.Full:
                self.error = "the disk is too slow"

    def _write(self) -> None:
        try:
            with self._file:
                writer = Writer(self._file, compression=CompressionType.ZSTD)
                writer.start(profile="", library=f"tetractl {__version__}")
                channels: dict[str, int] = {}
                while (passage := self._queue.get()) is not None:
                    topic = f"/{passage.wire}/{'received' if passage.received else 'sent'}"
                    if topic not in channels:
                        channels[topic] = writer.register_channel(topic, "raw", 0)
                    writer.add_message(
                        channels[topic], max(0, passage.t_ns), passage.data, max(0, passage.t_ns)
                    )
                writer.finish()
        except OSError as error:
            self.error = error.strerror or str(error)
            while self._queue.get() is not None:
                pass
