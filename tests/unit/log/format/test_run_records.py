"""Tests that the identity and the result of a trial are read as they were written, or refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit.random_trials import trial

from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import Result, Verdict
from tetractl.log.format import tetractl_pb2 as pb
from tetractl.log.format.run_records import (
    decode_facts,
    decode_result,
    encode_facts,
    encode_result,
    encode_run,
    run_items,
)
from tetractl.verification.comparison import first_difference

MADE_UP = trial(steps=2)
NUMBERS = st.floats(-1e6, 1e6)


def each(robots, numbers=NUMBERS):
    return st.lists(numbers, min_size=robots, max_size=robots).map(tuple)


@st.composite
def results(draw, robots=2):
    """Any result of a trial, in which each optional column is there or not."""

    def optional(numbers=NUMBERS):
        return draw(st.just(()) | each(robots, numbers))

    turn = optional()
    verdict = Verdict(
        Poses(*(np.array(draw(each(robots))) for _ in range(3))),
        draw(each(robots, st.booleans())),
        draw(each(robots)),
        edge=optional(),
        apart=optional(),
        turn=turn,
        turn_std=draw(each(len(turn))),
    )
    return Result(
        outcome=draw(st.sampled_from(Outcome)),
        reason=draw(st.sampled_from(["", "green is lost"])),
        steps=draw(st.integers(0, 2**31 - 1)),
        duration_s=draw(NUMBERS),
        total_error=draw(NUMBERS),
        robot_errors=draw(each(robots)),
        verdict=verdict,
        solve_ns=draw(each(3, st.integers(0, 2**62))),
        deadline_misses=draw(st.integers(0, 2**31 - 1)),
        drove=draw(st.just(()) | each(3, st.booleans())),
        passed=draw(st.lists(NUMBERS, max_size=4).map(tuple)),
        inside=optional(st.floats(0, 1)),
        lost=optional(st.integers(0, 9)),
        wheel_lag_s=draw(st.none() | st.floats(0, 1)),
    )


def host_end(result):
    return pb.HostEnd(
        solve_ns=result.solve_ns, deadline_misses=result.deadline_misses, drove=result.drove
    )


@settings(max_examples=20)
@given(results(), st.integers(0, 99))
def test_a_result_is_read_as_it_was_written(result, warnings):
    message = pb.Result.FromString(encode_result(result, "um", warnings).SerializeToString())
    assert (message.unit, message.warnings) == ("um", warnings)
    assert first_difference(decode_result(message, host_end(result), 2), result) is None


@settings(max_examples=10)
@given(results())
def test_without_the_records_of_the_host_a_result_lacks_only_its_times(result):
    untimed = replace(result, solve_ns=(), deadline_misses=0, drove=())
    assert first_difference(decode_result(encode_result(result, "mm"), None, 2), untimed) is None


COLUMNS = {"robot_errors", "entered", "clearance", "final_x", "final_y", "final_heading"}
OPTIONAL = {"edge", "apart", "inside", "lost", "turn", "turn_std"}


def whole():
    numbers = (1.0, 2.0)
    verdict = Verdict(
        Poses(*np.ones((3, 2))), (False, True), numbers, "", numbers, numbers, numbers, numbers
    )
    result = replace(
        MADE_UP.result, robot_errors=numbers, verdict=verdict, inside=numbers, lost=(0, 1)
    )
    return encode_result(result, "mm")


@pytest.mark.parametrize("column", sorted(COLUMNS | OPTIONAL))
def test_a_column_with_one_robot_more_or_less_is_refused(column):
    decode_result(whole(), None, 2)
    shorter, longer = whole(), whole()
    getattr(shorter, column).pop()
    getattr(longer, column).append(getattr(longer, column)[0])
    for message in (shorter, longer):
        with pytest.raises(ValueError, match="different numbers of robots"):
            decode_result(message, None, 2)


@pytest.mark.parametrize("column", sorted(COLUMNS | OPTIONAL))
def test_only_optional_columns_may_be_empty_and_a_turn_only_with_its_error(column):
    message = whole()
    message.ClearField(column)
    if column in OPTIONAL - {"turn", "turn_std"}:
        decode_result(message, None, 2)
        return
    with pytest.raises(ValueError, match="different numbers of robots"):
        decode_result(message, None, 2)


def test_the_distances_at_way_points_are_not_counted_by_robots():
    message = whole()
    for count in (0, 1, 5):
        message.passed[:] = [1.0] * count
        assert len(decode_result(message, None, 2).passed) == count


def test_an_outcome_that_there_is_not_is_refused():
    message = whole()
    message.outcome = "exploded"
    with pytest.raises(ValueError, match="exploded"):
        decode_result(message, None, 2)


@given(st.dictionaries(st.text(max_size=5), st.text(max_size=5), max_size=4))
def test_facts_are_read_as_they_were_written(facts):
    assert decode_facts(encode_facts(facts)) == facts


def test_a_run_in_a_lab_is_told_from_others_by_its_time_and_a_simulation_is_not():
    simulated = encode_run(MADE_UP.start)
    begin = f"{MADE_UP.start.spec_hash[:12]}-{MADE_UP.start.seed}-0"
    assert (simulated.run_id, simulated.mode) == (begin, "sim")
    lab = trial(steps=1, simulated=False).start
    run = encode_run(lab)
    assert run.run_id == f"{lab.spec_hash[:12]}-{lab.seed}-0-{lab.start_unix_ns}"
    assert run.mode == "lab"


def test_the_items_of_a_run_are_its_fields_with_the_facts_of_its_plant():
    run = encode_run(MADE_UP.start)
    items = run_items(run)
    assert "facts" not in items
    assert items["robots"] == '["robot 0", "robot 1", "robot 2"]'
    assert items["seed"] == str(MADE_UP.start.seed)
    assert items["plant.fw"] == "ü=1"
    assert items["plant"] == "sim"
    assert float(items["camera_rate_hz"]) == 120.0
