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
    """An emulated device's publisher or subscription of a topic.

    Args:
        topic: The topic, as the emulated device uses it.
        name: Name of the port, ros2://DOMAIN/TOPIC.
    """

    def __init__(self, topic: Topic, name: str) -> None:
        super().__init__(name)
        self._end = TopicEnd(topic, domain_of(name))
        self._received = deque[bytes]()
        self._stalled = False
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def plug(self) -> None:
        """Join the topic.

        Raises:
            TetractlError: If the topic cannot be joined.
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

    def set_stalled(self, is_stalled: bool) -> None:
        """Drop all messages to and from the topic if `is_stalled`, or pass messages on again."""
        self._stalled = is_stalled

    def baud(self) -> None:
        """Return None, because a network has no baud rate."""

    def read(self) -> bytes:
        """Return the bytes of the oldest waiting message, or b"" if there is no message.

        The method never waits.
        """
        with suppress(BlockingIOError, OSError):
            os.eventfd_read(self.fd)
        return self._received.popleft() if self._received else b""

    def write(self, data: bytes) -> None:
        """Publish a message.

        The message is lost if the plug is pulled or stalled, or if DDS cannot send it.
        """
        if self.fd >= 0 and not self._stalled:
            with suppress(DDSException):
                self._end.publish(data)

    def _receive(self) -> None:
        """Receive messages until the plug is pulled.

        Messages that arrive while the plug is stalled are lost.
        """
        while not self._closing.is_set():
            for message in self._end.wait():
                if not self._stalled:
                    self._received.append(message)
                    os.eventfd_write(self.fd, 1)


def on_topics(stage: Stage, domain: int, topics: Iterable[Topic]) -> Stage:
    """Create a stage on which ports are topics of a ROS 2 graph.

    If the wires of the stage are in memory, the stage is returned unchanged.

    Args:
        stage: The data and functions that the lab's emulated devices share.
        domain: The ROS domain.
        topics: The topics.
    """
    if stage.wires.ports is not None:
        return stage
    topic_by_address = {topic.address(domain): topic for topic in topics}

    def make_port(name: Path | str) -> PseudoPort:
        return TopicPlug(topic_by_address[str(name)], str(name))

    return replace(stage, wires=replace(stage.wires, port=make_port))
