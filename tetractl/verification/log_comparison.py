"""Compare the log of a trial with the log of the same trial run again, record by record."""

from collections.abc import Iterator
from itertools import zip_longest

from google.protobuf.message import DecodeError

from tetractl.log.format import channels
from tetractl.log.format.channels import CHANNELS, Entry
from tetractl.log.format.tetractl_pb2 import ControllerStep
from tetractl.log.read.raw_log import RawLog
from tetractl.verification.comparison import Difference, first_difference

NOT_COMPARED = {*channels.HOST_RECORDS, channels.DIGESTS, channels.RECOVERED}
"""Names of records that differ, or are missing, when a trial is run again."""


def log_differences(again: RawLog, log: RawLog) -> Iterator[Difference]:
    """Compare the log of a trial with the log of the same trial run again.

    Yields:
        The first difference in each channel and attachment; differences in control steps come
        first. Attachments that only the log has are not compared, because other programs may add
        them.
    """
    topics = [topic for topic in CHANNELS if topic not in NOT_COMPARED]
    names = again.attachments.keys() - NOT_COMPARED
    differences: list[Difference] = []
    for topic in topics:
        difference = _topic_difference(again, log, topic)
        if difference is not None:
            differences.append(difference)
    yield from sorted(differences, key=lambda difference: difference.step is None)
    for name in sorted(names):
        logged = log.attachments.get(name)
        if logged is None:
            yield Difference(None, name, "missing")
        elif logged.data != again.attachments[name].data:
            yield Difference(None, name, "differs from the experiment's")


def _topic_difference(again: RawLog, log: RawLog, topic: str) -> Difference | None:
    """Return the first difference between the messages of a topic.

    The result is None if all are equal.

    A message that only one of the logs contains is a difference.
    """
    pairs = zip_longest(again.by_topic[topic], log.by_topic[topic])
    for number, (ours, logged) in enumerate(pairs):
        if ours != logged:
            return _entry_difference(ours, logged, topic, number)
    return None


def _entry_difference(
    ours: Entry | None, logged: Entry | None, topic: str, number: int
) -> Difference:
    """Describe how a message of the repeated trial differs from the message in the log.

    Args:
        ours: The message of the trial run again; None if it has none of this number.
        logged: The message in the log; None if it has none of this number.
        topic: Topic of both.
        number: Which message of its topic they are, from 0.
    """
    name = f"{topic}[{number}]"
    if logged is None:
        return Difference(None, name, "missing")
    if ours is None:
        return Difference(None, name, "does not belong to this trial")
    times = (ours.log_ns, ours.publish_ns)
    logged_times = (logged.log_ns, logged.publish_ns)
    if logged_times != times:
        return Difference(None, name, f"has the times {logged_times} instead of {times}")
    message = CHANNELS[topic]
    try:
        our_message = message.FromString(ours.data)
        logged_message = message.FromString(logged.data)
    except DecodeError:
        return Difference(None, name, "is not a valid message of its channel")
    step = our_message.k if isinstance(our_message, ControllerStep) else None
    where = name if step is None else ""
    difference = first_difference(our_message, logged_message, name=where)
    if difference is None:
        difference = Difference(None, name, "has other bytes")
    return difference.in_step(step)
