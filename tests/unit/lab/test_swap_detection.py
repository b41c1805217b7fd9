"""Who answers whose commands: N robots commanded to turn by a common direction, seen at 120 Hz."""

import itertools
from collections import deque

import numpy as np
import pytest

from tetractl.lab.swap_detection import SwapDetector

pytestmark = pytest.mark.slow

NAMES = ("green", "blue", "red")
A = np.array([6.0, 4.0, 3.0])
SPEED = 0.18  # m/s
BODY = 0.095  # m: the diameter of an m3pi
FRAME = 8_000_000
SEND = 25_000_000


def drive(
    answers,
    delay=0.08,
    seconds=2.0,
    directions=(1.2, 1.2),
    signs=(1, 1, 1),
    noise=0.003,
    lost=(),
    blind=(9.0, 9.0),
    silent=9.0,
):
    """Robot i does what robot answers[i] should, later by `delay`; None stands still, as do the
    `lost` after 0.2 s. No frame comes between the two times `blind` [s]; 0.1 s into it all robots
    are stopped. From `silent` on [s] no robot hears anything: each does what it heard last for
    0.25 s, and then stands.

    Returns the fault found and the metres driven until then. The direction changes every 0.2 s.
    """
    seen, random = SwapDetector(NAMES), np.random.default_rng(3)
    heading, shown, told = np.zeros(3), np.zeros(3), np.zeros(3)
    queue, acting, next_ns, last = deque(), None, 0, 0
    closed, opened = (round(second * 1e9) for second in blind)
    for now in range(FRAME, round(seconds * 1e9), FRAME):
        while next_ns <= now:
            u = directions[next_ns // 200_000_000 % len(directions)]
            told = A * np.sin(u - heading)
            if closed + 100_000_000 < next_ns <= opened:
                told = np.zeros(3)
            seen.sent(next_ns, told)
            queue.append((next_ns + round(delay * 1e9), told))
            next_ns += SEND
        deaf = round(silent * 1e9)
        while queue and queue[0][0] <= min(now, deaf):
            acting = queue.popleft()[1]
        if now > deaf + 250_000_000:
            acting = None
        for i in range(3):
            before = shown[i]
            if (
                acting is not None
                and answers[i] is not None
                and not (i in lost and now > 200_000_000)
            ):
                heading[i] += signs[i] * acting[answers[i]] * FRAME / 1e9
            if closed < now <= opened:
                continue
            shown[i] = heading[i] + random.normal(0, noise)
            seen.turned(i, now, now - last, shown[i] - before)
        last = last if closed < now <= opened else now
        if fault := seen.fault():
            return fault, SPEED * now / 1e9
    return "", SPEED * seconds


CHATTER = (1.2, -1.2)
WIDE = (0.4, 2.5, -2.0, 1.0, 3.0)


def cases(**fields):
    """Every combination of the values of fields, as arguments of `drive`."""
    return [dict(zip(fields, row, strict=True)) for row in itertools.product(*fields.values())]


OBEYS = [0, 1, 2]
STUCK = [OBEYS, [None, 1, 2], [0, None, 2], [None] * 3]
GAINS = [(0.8, 1.2, 1.0), (1.2, 0.8, 1.2), (1.0, 0.8, 1.25)]
SWAPPED_WHEELS = [(-1, 1, 1), (1, -1, 1), (1, 1, -1)]
BLIND = [(t, t + pause) for t in (0.1, 0.34, 0.57) for pause in (0.15, 0.45)]
HARMLESS = {
    "they do as commanded or stand still": cases(
        answers=STUCK, delay=[0.0, 0.1, 0.3], seconds=[3.0]
    ),
    "their wheels are not calibrated": cases(
        answers=[OBEYS], delay=[0.07], seconds=[3.0], signs=GAINS, noise=[0.01]
    ),
    "some stop halfway": cases(
        answers=[OBEYS], delay=[0.05], seconds=[3.0], lost=[(0,), (0, 1), (0, 1, 2)]
    ),
    # regression: a pause of the stream was counted with the turning commanded in its middle
    "they are not seen for a while": cases(
        answers=[OBEYS], delay=[0.02, 0.2], blind=[*BLIND, (0.1, 1.0), (0.4, 1.3)]
    ),
    # regression: what a robot heard last looked like what was commanded to another
    "they hear nothing any more": cases(
        answers=[OBEYS], delay=[0.02, 0.08], silent=np.arange(0.1, 1.4, 0.2)
    ),
    "one's wheels are swapped": cases(answers=[OBEYS], delay=[0.05], signs=SWAPPED_WHEELS),
}


@pytest.mark.long
@pytest.mark.parametrize("directions", [CHATTER, WIDE, (1.7, 2.9, 2.5, -1.0)])
@pytest.mark.parametrize("why", HARMLESS)
def test_no_robot_is_taken_for_another_where(why, directions):
    for case in HARMLESS[why]:
        assert drive(**case, directions=directions)[0] == "", case


@pytest.mark.parametrize("directions", [(1.2,), CHATTER, WIDE])
@pytest.mark.parametrize("delay", [0.02, 0.05, 0.1])
def test_two_that_are_swapped_are_noticed_within_little_more_than_a_body_length(delay, directions):
    fault, driven = drive([1, 0, 2], delay, directions=directions)
    assert (
        fault
        == "green and blue turn as another robot is commanded: are their numbers or bodies swapped?"
    )
    assert driven < 1.2 * BODY


def test_three_that_follow_one_another_are_noticed():
    fault, driven = drive([1, 2, 0], directions=WIDE)
    assert "turn as another robot is commanded" in fault
    assert driven < 2 * BODY


def test_one_with_the_number_of_another_is_noticed():
    fault, driven = drive([0, 1, 0], directions=WIDE)
    assert fault == "red turns as green is commanded, not as red is: is its number wrong?"
    assert driven < 3 * BODY


def test_robots_that_are_told_the_same_cannot_be_told_apart():
    seen = SwapDetector(NAMES[:2])
    for now in range(FRAME, 10**9, FRAME):
        seen.sent(now, (1.0, 1.0))
        for i in range(2):
            seen.turned(i, now, FRAME, FRAME / 1e9)
    assert seen.fault() == ""


def test_a_restart_forgets_what_was_seen():
    seen = SwapDetector(NAMES[:2])
    for now in range(FRAME, 400_000_000, FRAME):
        seen.sent(now, (1.0, -1.0))
        seen.turned(0, now, FRAME, -FRAME / 1e9)
        seen.turned(1, now, FRAME, FRAME / 1e9)
    assert "swapped" in seen.fault()
    seen.restart()
    assert seen.fault() == ""
