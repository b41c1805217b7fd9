"""Tests of a log's messages for users, and of the times of its parts."""

from dataclasses import replace

import numpy as np
import pytest
from testkit import random_trials
from testkit.trials import three_robots

from tetractl.core.trial import Note
from tetractl.log.read.trial_log import frame_gaps, step_gaps

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ("green is lost", "check that it is switched on"),
        ("the model does not fit: heading of green", "with `tetractl identify`"),
        ("the model fits again", ""),
        ("green stands still although it is sent a direction", ""),
        ("lost packets", ""),
    ],
)
def test_only_messages_that_need_it_say_what_to_do(text, advice):
    log = three_robots()
    (event,) = replace(log, notes=(Note(log.began_ns + 2_500_000_000, "warning", text),)).events
    assert event.text.startswith(text)
    assert advice in event.text
    assert (event.text == text) == (advice == "")
    assert (event.time_s, event.level) == (pytest.approx(2.5), "warning")


def test_messages_come_in_the_order_of_their_times():
    log = three_robots()
    notes = tuple(Note(log.began_ns + second * 10**9, "info", str(second)) for second in (3, -1, 2))
    assert [event.text for event in replace(log, notes=notes).events] == ["-1", "2", "3"]


def test_times_count_from_the_first_direction():
    log = three_robots()
    assert log.steps_s[0] == pytest.approx(0.0, abs=0.5)
    assert np.diff(log.steps_s) == pytest.approx(
        np.diff([step.command.sent_ns for step in log.steps]) / 1e9
    )
    assert (log.frames_s * 1e9 + log.began_ns) == pytest.approx(log.mocap_ns)


def test_a_robot_that_was_not_tracked_has_no_measured_position():
    log = three_robots()
    valid = log.valid.copy()
    valid[3, 1] = False
    positions = replace(log, valid=valid).positions
    assert np.isnan(positions[3, 1]).all()
    assert positions[3, 0] == pytest.approx(log.mocap[3, 0, :2])


# ---- Times, gaps and the last estimate ----

MADE_UP = random_trials.trial(steps=6, robots=2, frames=2, first=1, iterations=1, length=2)


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    """A log of six control steps at 5 Hz."""
    return random_trials.write_and_read(MADE_UP, tmp_path_factory.mktemp("log") / "t.mcap")


def sent_later(log, by_ns):
    def later(command):
        return replace(command, sent_ns=command.sent_ns + by_ns)

    steps = tuple(replace(step, command=later(step.command)) for step in log.steps)
    return replace(log, steps=steps, commands=tuple(map(later, log.commands)))


@pytest.mark.parametrize("by_ns", [0, 3 * 10**9])
def test_a_log_without_its_first_steps_and_commands_counts_from_where_they_began(made_up, by_ns):
    log = sent_later(made_up, by_ns)
    began_ns = log.began_ns
    assert began_ns == log.steps[0].command.sent_ns
    late = replace(log, steps=log.steps[2:], commands=())
    period_ns = round(log.start.setup.period_s * 10**9)
    assert late.began_ns == max(log.steps[2].command.sent_ns - 2 * period_ns, 0)


def test_a_direction_before_the_first_step_is_the_beginning(made_up):
    """In a lab robots are driven before the trial, to be recognised."""
    log = sent_later(made_up, 10**9)
    square = replace(log.commands[0], sent_ns=17)
    assert replace(log, commands=(square, *log.commands)).began_ns == 17


def test_no_time_is_before_the_clock(made_up):
    early = replace(made_up.steps[3], command=replace(made_up.steps[3].command, sent_ns=5))
    assert replace(made_up, steps=(early,), commands=()).began_ns == 0


def without_steps(log, *numbers):
    return replace(log, steps=tuple(step for step in log.steps if step.k not in numbers))


@pytest.mark.parametrize(
    ("lost", "gaps"),
    [
        ((), []),
        ((0,), [(0, 0)]),
        ((0, 1), [(0, 1)]),
        ((2,), [(2, 2)]),
        ((1, 2, 4), [(1, 2), (4, 4)]),
        ((5,), [(5, 5)]),
        ((4, 5), [(4, 5)]),
        (range(6), [(0, 5)]),
    ],
)
def test_missing_control_steps_are_found_at_both_ends_and_in_between(made_up, lost, gaps):
    found = step_gaps(without_steps(made_up, *lost))
    assert [(gap.first_number, gap.last_number) for gap in found] == gaps


def test_without_a_result_nobody_knows_how_many_steps_there_were(made_up):
    unfinished = replace(without_steps(made_up, 2, 5), result=None)
    assert [(gap.first_number, gap.last_number) for gap in step_gaps(unfinished)] == [(2, 2)]


def test_a_gap_says_between_which_times_it_is(made_up):
    (gap,) = step_gaps(without_steps(made_up, 2, 3))
    sent_s = [made_up.elapsed_s(made_up.steps[k].command.sent_ns) for k in (1, 4)]
    assert (gap.since_s, gap.until_s) == pytest.approx(sent_s)
    assert str(gap) == f"control steps 2 to 3, between {sent_s[0]:.3f} and {sent_s[1]:.3f} s"
    (gap,) = step_gaps(without_steps(made_up, 2))
    assert str(gap).startswith("control step 2, between ")
    (gap,) = step_gaps(without_steps(made_up, 5))
    assert gap.until_s == made_up.result.duration_s


@pytest.mark.parametrize(
    ("lost", "gaps"), [((), []), ((4,), [(4, 4)]), ((4, 5, 8), [(4, 5), (8, 8)]), ((0, 11), [])]
)
def test_missing_frames_are_found_between_others(made_up, lost, gaps):
    kept = ~np.isin(made_up.frames, lost)
    log = replace(made_up, frames=made_up.frames[kept], mocap_ns=made_up.mocap_ns[kept])
    found = frame_gaps(log)
    assert [(gap.first_number, gap.last_number) for gap in found] == gaps
    for gap in found:
        before, after = (
            made_up.frames_s[gap.first_number - 1],
            made_up.frames_s[gap.last_number + 1],
        )
        assert (gap.since_s, gap.until_s) == (before, after)
        assert str(gap).startswith("camera frame")


def test_the_last_estimate_is_that_of_the_last_step_even_if_it_has_none(made_up):
    assert made_up.last_estimate is made_up.steps[-1].plan.estimate is not None
    assert made_up.steps[3].plan.estimate is None
    assert replace(made_up, steps=made_up.steps[:4]).last_estimate is None
    assert replace(made_up, steps=()).last_estimate is None
