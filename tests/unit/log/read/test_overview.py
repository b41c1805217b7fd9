"""Tests of how often each channel of a log has messages."""

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.clock import SECOND
from tetractl.log.format.channels import Entry
from tetractl.log.read.overview import channel_counts


def contents(**times_ns):
    entries_by_topic = {
        topic: [Entry(topic, time_ns, time_ns, b"xyz") for time_ns in times]
        for topic, times in times_ns.items()
    }
    return SimpleNamespace(entries_by_topic=entries_by_topic, channels={})


@given(st.integers(2, 50), st.sampled_from([1, 5, 40]), st.randoms())
def test_a_regular_channel_has_its_rate_in_whatever_order_messages_were_written(count, hz, random):
    times = [SECOND + number * SECOND // hz for number in range(count)]
    random.shuffle(times)
    (channel,) = channel_counts(contents(steps=times))
    assert channel.messages == count
    assert channel.hz == pytest.approx(hz)
    assert channel.bytes == 3 * count


def test_one_message_and_messages_of_one_time_have_no_rate():
    channels = channel_counts(contents(one=[SECOND], same=[SECOND, SECOND], none=[]))
    assert [(channel.topic, channel.messages, channel.hz) for channel in channels] == [
        ("one", 1, None),
        ("same", 2, None),
    ]
