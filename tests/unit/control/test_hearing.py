"""How many commands in a row no robot hears."""

import numpy as np

from tetractl.control.filter import Heard
from tetractl.control.hearing import RUN, Hearing

FOR, AGAINST, NOTHING = 6.0, -6.0, np.nan  # ln of factors


def after(*commands):
    """What is known after commands, of each of which frames tell for three robots."""
    sent_s = 0.05 * np.arange(len(commands))
    return Hearing().after(Heard(sent_s, np.array(commands, dtype=float).reshape(-1, 3)))


def test_a_radio_that_lets_one_command_of_four_through_is_found():
    missed, heard = (AGAINST, AGAINST, AGAINST), (FOR, FOR, FOR)
    assert after(*[missed, missed, missed, heard] * 30).missed > 2.5


def test_a_command_that_one_robot_heard_is_not_missed():
    heard = after(*[(FOR, AGAINST, AGAINST), (AGAINST, FOR, FOR)] * 30)
    assert (heard.missed, heard.since) == (0.0, 0)


def test_a_repeated_command_that_one_robot_alone_missed_is_not_missed_by_all():
    """Regression: where each robot loses 30 % of the commands by itself, a signal was sent again to
    robots of which one had not heard it, and counted as missed by all if this one missed it too."""
    assert after(*[(AGAINST, NOTHING, NOTHING), (FOR, NOTHING, NOTHING)] * 30).missed == 0.0


def test_a_silence_does_not_count():
    missed, heard = (AGAINST, AGAINST, AGAINST), (FOR, FOR, FOR)
    assert after(*([missed] * (RUN + 1) + [heard]) * 3).missed == 0.0


def test_one_event_is_not_many_missed_commands():
    missed, heard = (AGAINST, AGAINST, AGAINST), (FOR, FOR, FOR)
    event = [missed] * RUN + [heard]
    assert not after(*event).misses_many
    assert after(*event, *event).misses_many


def test_a_signal_that_is_sent_again_tells_nothing_of_the_commands_missed():
    """Regression: while signals were kept fewer and fewer commands seemed to be missed, and half of
    the time signals were searched again."""
    missed, heard, repeated = (AGAINST,) * 3, (FOR,) * 3, (NOTHING,) * 3
    learnt = (missed, missed, missed, heard) * 10
    kept = (heard, repeated, repeated, repeated) * 30
    # of the kept signals the first one alone follows a command of which frames showed
    assert after(*learnt, *kept).missed == after(*learnt, heard).missed


def test_commands_that_are_no_news_tell_nothing():
    shown = after((NOTHING, NOTHING, NOTHING), (0.1, -0.1, NOTHING))
    assert (shown.missed, shown.since) == (0.0, 0)


def test_each_command_counts_once():
    sent_s = np.array([1.0, 1.05])
    missed = np.full((2, 1), AGAINST)
    once = Hearing().after(Heard(sent_s, missed))
    assert once.since == 2
    assert once.after(Heard(sent_s, missed)) == once
