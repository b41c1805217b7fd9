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


def log_differences(repeated: RawLog, log: RawLog) -> Iterator[Difference]:
    """Compare the log of a trial with the log of the same trial when it was run again.

    Args:
        repeated: The log of the trial when it was run again.
        log: The log to verify.

    Yields:
        The first difference in each channel and attachment; differences in control steps come
        first. Attachments that only the log has are not compared, because other programs may add
        them.
    """
    topics = [topic for topic in CHANNELS if topic not in NOT_COMPARED]
    names = repeated.attachments.keys() - NOT_COMPARED
    differences: list[Difference] = []
    for topic in topics:
        difference = _topic_difference(repeated, log, topic)
        if difference is not None:
            differences.append(difference)
    yield from sorted(differences, key=lambda difference: difference.step is None)
    for name in sorted(names):
        logged = log.attachments.get(name)
        if logged is None:
            yield Difference(None, name, "missing")
        elif logged.data != repeated.attachments[name].data:
            yield Difference(None, name, "differs from the experiment's")


def _topic_difference(repeated: RawLog, log: RawLog, topic: str) -> Difference | None:
    """Find the first difference between the messages of a topic in two logs.

    A message that only one of the logs contains is a difference. The result is None if all messages
    are equal.
    """
    entry_pairs = zip_longest(repeated.entries_by_topic[topic], log.entries_by_topic[topic])
    for number, (computed, logged) in enumerate(entry_pairs):
        if computed != logged:
            return _entry_difference(computed, logged, topic, number)
    return None


def _entry_difference(
    computed: Entry | None, logged: Entry | None, topic: str, number: int
) -> Difference:
    """Describe how a message of the repeated trial differs from the message in the log.

    Args:
        computed: The message of the repeated trial. None if that trial has fewer messages.
        logged: The message in the log. None if the log has fewer messages.
        topic: Topic of both messages.
        number: Index of the message within its topic, from 0.
    """
    name = f"{topic}[{number}]"
    if logged is None:
        return Difference(None, name, "missing")
    if computed is None:
        return Difference(None, name, "does not belong to this trial")
    computed_times = (computed.log_ns, computed.publish_ns)
    logged_times = (logged.log_ns, logged.publish_ns)
    if logged_times != computed_times:
        return Difference(None, name, f"has the times {logged_times} instead of {computed_times}")
    message_class = CHANNELS[topic]
    try:
        computed_message = message_class.FromString(computed.data)
        logged_message = message_class.FromString(logged.data)
    except DecodeError:
        return Difference(None, name, "is not a valid message of its channel")
    step = computed_message.k if isinstance(computed_message, ControllerStep) else None
    location = name if step is None else ""
    difference = first_difference(computed_message, logged_message, name=location)
    if difference is None:
        difference = Difference(None, name, "has other bytes")
    return difference.in_step(step)
