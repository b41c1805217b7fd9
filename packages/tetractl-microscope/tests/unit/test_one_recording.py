"""Tests of deciding whether poses and commands belong to the same recording."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.one_recording import (
    FileSpan,
    Reading,
    check_explained,
    describe_clock_mismatch,
    refuse_times_apart,
)

from tetractl.core.errors import UsageError

OTHER = "another reading"


def checked(stated, *others, at_least=0.0):
    """The message about commands that explain a fraction, and other readings; "" for none."""
    readings = [Reading(fraction, f"{OTHER} {k}", "do this") for k, fraction in enumerate(others)]
    try:
        check_explained("commands.csv", "turns", stated, at_least, readings)
    except UsageError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("stated", "other"),
    [
        (0.1, 0.9),  # explains more
        (0.0, 0.41),  # just enough
        (-0.3, 0.45),
        (0.8, 0.96),  # leaves a fifth of what the stated reading leaves
    ],
)
def test_a_reading_that_certainly_explains_more_is_named(stated, other):
    message = checked(stated, 0.05, other, 0.2)
    assert message.startswith(f"{OTHER} 1")
    assert "do this" in message


@pytest.mark.parametrize(
    ("stated", "other"),
    [
        (0.1, 0.39),  # explains little itself
        (0.5, 0.69),  # explains hardly more, and leaves much
        (0.8, 0.94),
        (0.9, 0.9),
        (1.0, 1.0),  # both leave nothing
        (0.95, 0.6),
    ],
)
def test_commands_are_believed_if_no_reading_is_certainly_better(stated, other):
    assert checked(stated, other) == ""


@pytest.mark.parametrize(
    ("explained", "at_least", "says"),
    [
        (0.29, 0.3, "only 29% of the turns"),
        (-0.4, 0.3, "only 0% of the turns"),
        (0.3, 0.3, ""),
        (0.31, 0.3, ""),
        (-0.4, -1.0, ""),
    ],
)
def test_commands_that_explain_too_little_are_refused_from_a_limit_on(explained, at_least, says):
    message = checked(explained, 0.1, at_least=at_least)
    assert says in message
    assert bool(message) == bool(says)


def spans(begin, end, sent_from, sent_until=math.inf):
    return FileSpan("poses.csv", begin, end), FileSpan("sent.csv", sent_from, sent_until)


@pytest.mark.parametrize(
    ("sent_from", "sent_until", "refused"),
    [
        (12.0, 13.0, False),  # within the recording
        (9.0, 10.1, False),  # a tenth of a second is shared
        (9.0, 10.0, True),  # they only touch
        (0.0, 3.0, True),  # all before
        (20.0, 30.0, True),
        (25.0, 30.0, True),  # all after
        (19.9, 30.0, False),
    ],
)
def test_commands_are_refused_if_none_acts_during_the_recording(sent_from, sent_until, refused):
    poses, commands = spans(10.0, 20.0, sent_from, sent_until)
    sent = np.array([sent_from, (sent_from + sent_until) / 2])
    if not refused:
        refuse_times_apart(poses, sent, commands)
        return
    with pytest.raises(UsageError) as error:
        refuse_times_apart(poses, sent, commands)
    line = str(error.value)
    assert f"sent.csv, {sent_from:g} to {sent[-1]:g} s:" in line
    assert "poses.csv, 10 to 20 s" in line


def remark(sent, begin=0.0, end=10.0, of_way=1.0):
    poses, commands = spans(begin, end, float(sent[0]))
    return describe_clock_mismatch(poses, np.asarray(sent, float), commands, of_way)


@given(st.floats(-1e3, 1e6), st.floats(2.0, 500.0), st.integers(2, 40))
def test_commands_that_are_sent_through_a_recording_get_no_remark(begin, lasts_s, count):
    sent = np.linspace(begin, begin + 0.9 * lasts_s, count)
    assert remark(sent, begin, begin + lasts_s) is None


def test_commands_that_cover_a_part_of_the_path_are_remarked_on_with_both_times():
    sent = [6.0, 7.0, 8.0]
    assert remark(sent, 2.0, 10.0, of_way=0.5) == (
        "sent.csv covers only 4 s of the 8 s of poses.csv"
    )
    assert remark(sent, 2.0, 10.0, of_way=0.89) is not None
    assert remark(sent, 2.0, 10.0, of_way=0.9) is None


@pytest.mark.parametrize(
    ("sent", "within"),
    [
        ([-20.0, -10.0, 0.0], 1),  # the last one acts all the time
        ([-20.0, -10.0, -1.0], 0),
        ([-20.0, -10.0, 10.0], 0),  # the recording ends when the last is sent
        ([0.0, 10.0, 30.0], 1),
        (1000.0 * np.arange(30), 1),  # milliseconds as seconds
        (500.0 + np.arange(-500.0, 2000.0, 2.1), 5),
    ],
)
def test_a_recording_with_hardly_any_of_many_commands_is_remarked_on(sent, within):
    line = remark(sent)
    assert line is not None
    are = "is" if within == 1 else "are"
    assert line.startswith(f"only {within} of the {len(sent)} times of sent.csv {are} within")


@pytest.mark.parametrize(
    "sent",
    [
        [0.0],  # one direction for the whole recording
        [-5.0],
        [0.0, 9.9],
        [-30.0, 1.0, 2.0],
        np.arange(0.0, 900.0, 3.0),  # a long experiment, of which a part was filmed
        np.arange(-1000.0, 1000.0, 0.5),  # a very long one, with 20 commands in the film
    ],
)
def test_honest_commands_get_no_remark(sent):
    assert remark(sent) is None


def test_times_of_commands_do_not_matter_if_all_are_shifted_with_the_poses():
    """Seconds since 1970 are as good as seconds since the start."""
    sent = np.array([-20.0, -10.0, 0.0])
    early = remark(sent)
    late = remark(sent + 1.7e9, 1.7e9, 1.7e9 + 10.0)
    assert early == late
