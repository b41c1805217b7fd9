"""Lets devices use ROS 2 topics like ports. This process joins the ROS 2 graph through DDS.

ROS 2 sends the topic `/cmd_vel` as the DDS topic `rt/cmd_vel`. A `Topic` says which messages a
topic carries, and with which quality of service (QoS). A `TopicEnd` publishes on a topic, or
subscribes to it. A `TopicPort` makes such an end the port of a camera or actuator. Each write or
read of a port is the bytes of one message, so that emulated devices can pass the same bytes in
memory.

    twist = Topic("/green/cmd_vel", Twist, publishes=True)
    port = TopicPort(twist, "ros2://0/green/cmd_vel", 0, "green", clock, hear, "is green on?")
    port.open()
    port.settle()
    port.write(Twist(linear=Vector3(x=0.1)).serialize())
"""

import os
import threading
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

from cyclonedds import core, sub
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import (
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic as DdsTopic

from tetractl.core.clock import MILLISECOND, SECOND, Clock
from tetractl.core.errors import AbortError
from tetractl.lab.client_port import ClientPort
from tetractl.lab.serial_port import UNREADABLE, OnReceived, PortFactory
from tetractl.lab.udp_port import lock_address

SCHEME = "ros2://"
"""Beginning of a port's name: ros2://DOMAIN/TOPIC."""
DDS_PREFIX = "rt"
"""Prefix that ROS 2 adds to the name of a topic in DDS."""
DISCOVERY_S = 3.0
"""Maximum time to wait for the other nodes of a topic [s]. Nodes on one network find each other
within some 0.1 s."""
WAIT_NS = 100 * MILLISECOND
"""Maximum time that a thread waits for messages [ns].

Then it checks whether its port is closed.
"""
MESSAGES_MAX = 100
"""Maximum number of messages that are taken at once, and that a subscription keeps."""
PUBLISHERS_MAX = 1000
"""Maximum number of publishers of a graph that are examined."""
BLOCKING_NS = 20 * MILLISECOND
"""Maximum time for which a write may wait for a slow subscriber [ns]."""
UNDECODABLE = b"\xff"
"""Data that a subscription passes on for a message that is not of the topic's type.

They cannot be decoded either, so that the receiver counts the message as unreadable.
"""

_participants: WeakValueDictionary[int, DomainParticipant] = WeakValueDictionary()
_participants_lock = threading.Lock()


def join_domain(domain: int) -> DomainParticipant:
    """Join a ROS domain, and return this process's DDS participant in the domain.

    All users in this process share the participant. It leaves the graph when nobody uses it.

    Raises:
        AbortError: If DDS cannot open its sockets.
    """
    with _participants_lock:
        joined = _participants.get(domain)
        if joined is None:
            try:
                joined = DomainParticipant(domain)
            except core.DDSException as error:
                raise AbortError(
                    f"cannot join ROS domain {domain}: {error.msg}",
                    "does CYCLONEDDS_URI name a network interface that this computer has?",
                ) from None
            _participants[domain] = joined
        return joined


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a ROS 2 graph, and how this process uses it.

    Attributes:
        name: Name of the topic in ROS 2, such as `/green/cmd_vel`.
        message: The class of the topic's messages, from `ros2_messages`.
        publishes: Whether this process publishes on the topic. If not, the process subscribes.
        latched: Whether a later subscriber still receives the last message (QoS transient local).
    """

    name: str
    message: type[IdlStruct]
    publishes: bool = False
    latched: bool = False

    def address(self, domain: int) -> str:
        """Return the name of the topic's port, ros2://DOMAIN/TOPIC."""
        return f"{SCHEME}{domain}{self.name}"

    @property
    def qos(self) -> Qos:
        """The quality of service (QoS) of this process's publisher or subscription.

        A publisher is reliable, so that it reaches reliable and best-effort subscribers. It keeps
        only its last message, so that an old command is never sent again. A subscription asks for
        best effort, so that it receives from reliable and best-effort publishers.
        """
        durability = (
            Policy.Durability.TransientLocal if self.latched else Policy.Durability.Volatile
        )
        cdr = Policy.DataRepresentation(use_cdrv0_representation=True)
        if self.publishes:
            reliable = Policy.Reliability.Reliable(max_blocking_time=BLOCKING_NS)
            return Qos(reliable, durability, Policy.History.KeepLast(1), cdr)
        best_effort = Policy.Reliability.BestEffort
        return Qos(
            best_effort, Policy.Durability.Volatile, Policy.History.KeepLast(MESSAGES_MAX), cdr
        )


class TopicEnd:
    """A publisher or subscription of this process for a topic in a ROS domain.

    Args:
        topic: The topic.
        domain: The ROS domain.

    Attributes:
        topic: The topic.
    """

    def __init__(self, topic: Topic, domain: int) -> None:
        self.topic = topic
        self._domain = domain
        self._writer: DataWriter[Any] | None = None
        self._reader: sub.DataReader[Any] | None = None
        self._arrivals: WaitSet | None = None

    def open(self) -> None:
        """Announce the publisher or subscription to the ROS 2 graph.

        Raises:
            AbortError: If DDS rejects the topic, for example because of its name.
        """
        joined = join_domain(self._domain)
        try:
            dds_topic = DdsTopic(joined, DDS_PREFIX + self.topic.name, self.topic.message)
            if self.topic.publishes:
                self._writer = DataWriter(joined, dds_topic, qos=self.topic.qos)
            else:
                self._reader = sub.DataReader(joined, dds_topic, qos=self.topic.qos)
                unread = ViewState.Any | InstanceState.Any | SampleState.NotRead
                self._arrivals = WaitSet(joined)
                self._arrivals.attach(ReadCondition(self._reader, unread))
        except core.DDSException as error:
            raise AbortError(
                f"{self.topic.name}: {error.msg}",
                "check the topic's name: it may have letters, digits, _ and /",
            ) from None

    def close(self) -> None:
        """Leave the topic. Can be called repeatedly."""
        self._arrivals = None
        self._reader = None
        self._writer = None

    def publish(self, data: bytes) -> None:
        """Publish a message, given as bytes.

        Raises:
            DDSException: If DDS does not accept the message.
            AbortError: If the end is not open.
        """
        if self._writer is None:
            raise AbortError(f"the topic {self.topic.name} is not open")
        self._writer.write(self.topic.message.deserialize(data))

    def wait(self) -> list[bytes]:
        """Wait for messages for at most WAIT_NS.

        Returns:
            The bytes of each message that has arrived. A message that cannot be decoded is returned
            as UNDECODABLE. The list is empty if the subscription is not open.
        """
        arrivals = self._arrivals
        reader = self._reader
        if arrivals is None or reader is None:
            return []
        arrivals.wait(WAIT_NS)
        messages: list[bytes] = []
        for _ in range(MESSAGES_MAX):
            try:
                samples = reader.take(1)  # one by one: an undecodable message loses its batch
            except UNREADABLE:
                messages.append(UNDECODABLE)
                continue
            if not samples:
                break
            messages += [sample.serialize() for sample in samples if isinstance(sample, IdlStruct)]
        return messages

    @property
    def n_partners(self) -> int:
        """Number of subscribers or publishers at the topic's other end. 0 if it is not open."""
        if self._writer is not None:
            return len(self._writer.get_matched_subscriptions())
        return 0 if self._reader is None else len(self._reader.get_matched_publications())

    def count_other_publishers(self) -> int:
        """Count the other publishers of the topic in the graph, in this or any other process."""
        dds_name = DDS_PREFIX + self.topic.name
        own_key = None if self._writer is None else self._writer.guid
        reader = BuiltinDataReader(join_domain(self._domain), BuiltinTopicDcpsPublication)
        publishers = [
            publisher
            for publisher in reader.read(PUBLISHERS_MAX)
            if isinstance(publisher.topic_name, str)
        ]
        return sum(
            publisher.topic_name == dds_name and publisher.key != own_key
            for publisher in publishers
        )


class TopicPort(ClientPort):
    """A topic that a camera or an actuator uses like a `SerialPort`.

    Args:
        topic: The topic.
        name: Name of the port, ros2://DOMAIN/TOPIC.
        baud: Ignored, because a topic has no baud rate.
        device: The device on the topic, for error messages.
        clock: The clock for times.
        on_received: Called with the bytes of each message and its time of arrival [ns].
        hint: Hint for error messages.

    Attributes:
        end: The publisher or subscription.
    """

    def __init__(
        self,
        topic: Topic,
        name: str,
        baud: int,
        device: str,
        clock: Clock,
        on_received: OnReceived,
        hint: str,
    ) -> None:
        super().__init__(name, baud, device, clock, on_received, hint)
        self.end = TopicEnd(topic, domain_of(name))
        self._lock_fd: int | None = None  # file descriptor of the lock; None without a lock
        self._wait_until_ns = 0  # when the port stops waiting for subscribers

    def open(self, exclusive: bool = True) -> None:
        """Join the topic.

        A publisher is ready once somebody subscribes, or after DISCOVERY_S. If nobody subscribes,
        `refusal` contains a message.

        Args:
            exclusive: Whether to refuse a topic on which another program here publishes.

        Raises:
            PortHeldError: If `exclusive` is True, and another program of this computer publishes on
                the topic.
            AbortError: If the topic cannot be joined.
        """
        if exclusive and self.end.topic.publishes:
            self._lock_fd = lock_address(self._name)
        self.end.open()
        super().open(exclusive)
        self._wait_until_ns = self._clock.now() + round(DISCOVERY_S * SECOND)

    def is_ready(self) -> bool:
        """Check whether a node subscribes to the topic, or has had enough time to appear.

        The port of a subscription is always ready.
        """
        if not self.end.topic.publishes:
            return True
        return self.look_for_subscribers() or self._clock.now() >= self._wait_until_ns

    def look_for_subscribers(self) -> bool:
        """Check whether any node subscribes to the topic, and set `refusal` if none does."""
        is_received = self.end.n_partners > 0
        self.refusal = None if is_received else f"no node subscribes to {self.end.topic.name}"
        return is_received

    def write(self, data: bytes) -> int:
        """Publish a message.

        Args:
            data: The bytes of the message.

        Returns:
            The time of publishing [ns].

        Raises:
            AbortError: If the topic is not open, or if DDS does not accept the message.
        """
        with self._write_lock:
            if self.failure:
                raise AbortError(self.failure, self._hint)
            try:
                self.end.publish(data)
            except core.DDSException as error:
                raise self._fail(f"accepts no message: {error}") from None
            return self._clock.now()

    def connect(self) -> None:
        """Do nothing, because `open` has already joined the topic."""

    def wait(self) -> None:
        """Pass on the messages that have arrived. The port of a publisher only waits."""
        if self.end.topic.publishes:
            super().wait()
        else:
            for message in self.end.wait():
                self.take(message)

    def close(self) -> None:
        """Leave the topic, and release its lock. Can be called repeatedly, and never raises."""
        super().close()
        with suppress(core.DDSException):
            self.end.close()
        if self._lock_fd is not None:
            os.close(self._lock_fd)
            self._lock_fd = None


def domain_of(name: str) -> int:
    """Extract the ROS domain from the name of a port, ros2://DOMAIN/TOPIC."""
    return int(name.removeprefix(SCHEME).partition("/")[0])


def ports_of(topics: Iterable[Topic]) -> PortFactory:
    """Create a function that creates the port of one of these topics, given the port's name.

    The function raises a `KeyError` for the name of any other topic.
    """
    topic_by_name = {topic.name: topic for topic in topics}

    def make_port(name: str, *arguments: Any) -> TopicPort:
        domain_and_topic = name.removeprefix(SCHEME)
        topic = topic_by_name["/" + domain_and_topic.partition("/")[2]]
        return TopicPort(topic, name, *arguments)

    return make_port
