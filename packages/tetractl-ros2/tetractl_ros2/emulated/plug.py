"""The emulation's end of a ROS 2 topic, used like the end of a serial port.

With wires in memory, the bytes of messages are passed on unchanged. In real time, an emulated
device is a participant of the ROS 2 graph, like a real device. A thread then receives messages, and
wakes the emulation's loop through a file descriptor.
"""

import os
import threading
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from cyclonedds.core import DDSException
from tetractl_emulator.port import PseudoPort
from tetractl_emulator.sides import Stage

from tetractl.core.errors import AbortError, TetractlError
from tetractl_ros2.topic_port import Topic, TopicEnd, domain_of


class TopicPlug(PseudoPort):
    """An emulated device's publisher or subscription of a topic. `name` is the name of its port."""

    def __init__(self, topic: Topic, name: str) -> None:
        super().__init__(name)
        self._end = TopicEnd(topic, domain_of(name))
        self._came = deque[bytes]()
        self._stalled = False
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def plug(self) -> None:
        """Join the topic.

        Raises:
            TetractlError: If that fails.
        """
        try:
            self._end.open()
        except AbortError as error:
            raise TetractlError(error.message, hint=error.hint) from None
        self.fd = os.eventfd(0, os.EFD_NONBLOCK)
        self._closing.clear()
        if not self._end.topic.publishes:
            self._thread = threading.Thread(target=self._receive, name=self.name, daemon=True)
            self._thread.start()

    def unplug(self) -> None:
        """Leave the topic, and wait up to 2 s for the receiving thread.

        Can be called repeatedly.
        """
        self._closing.set()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None
        self._end.close()
        if self.fd >= 0:
            os.close(self.fd)
        self.fd = -1

    def stall(self, stalled: bool) -> None:
        """Start or stop dropping everything that is sent to the topic, or that arrives from it."""
        self._stalled = stalled

    def baud(self) -> None:
        """None, because a network has no baud rate."""

    def read(self) -> bytes:
        """Return the bytes of the oldest waiting message.

        The result is empty if there is none. It never waits.
        """
        with suppress(BlockingIOError, OSError):
            os.eventfd_read(self.fd)
        return self._came.popleft() if self._came else b""

    def write(self, data: bytes) -> None:
        """Publish a message.

        It is lost if the plug is pulled or stalled, or if it cannot be sent.
        """
        if self.fd >= 0 and not self._stalled:
            with suppress(DDSException):
                self._end.publish(data)

    def _receive(self) -> None:
        """Receive messages until the plug is pulled.

        Messages that arrive while it is stalled are lost.
        """
        while not self._closing.is_set():
            for message in self._end.wait():
                if not self._stalled:
                    self._came.append(message)
                    os.eventfd_write(self.fd, 1)


def on_topics(stage: Stage, domain: int, topics: Iterable[Topic]) -> Stage:
    """Create a stage on which the ports named after these topics are topics of a ROS 2 graph.

    If the wires of the stage are in memory, the stage stays unchanged.

    Args:
        stage: The data and functions that the lab's emulated devices share.
        domain: The ROS domain.
        topics: The topics.
    """
    if stage.wires.ports is not None:
        return stage
    by_name = {topic.address(domain): topic for topic in topics}

    def port(name: Path | str) -> PseudoPort:
        return TopicPlug(by_name[str(name)], str(name))

    return replace(stage, wires=replace(stage.wires, port=port))
