"""What is written is what is read, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.random_trials import trial, write

from tetractl.core.commands import Command, Steer
from tetractl.core.plan import Outcome, State
from tetractl.log.format import codec
from tetractl.log.format.channels import RESULT
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.salvage import scan
from tetractl.log.write.writer import LogWriter
from tetractl.replay.comparison import first_difference


def assert_same_trial(log, made):
    seen = [sample.observation for sample in made.samples]
    assert log.damage is None
    assert not first_difference(log.start, made.start)
    assert not first_difference(log.steps, tuple(made.steps))
    assert not first_difference(log.stop, made.stop)
    assert not first_difference(log.result, made.result)
    assert log.start.seed == made.experiment.trials.seed
    assert not first_difference(log.frames, np.array([item.frame for item in seen], dtype=np.int64))
    assert not first_difference(
        log.mocap_ns, np.array([item.sampled_ns for item in seen], dtype=np.int64)
    )
    assert not first_difference(
        log.received_ns, np.array([item.received_ns for item in seen], dtype=np.int64)
    )
    assert not first_difference(log.mocap, np.array([item.poses.array() for item in seen]))
    assert not first_difference(log.valid, np.array([item.valid for item in seen]))
    if made.start.plant.simulated:
        assert not first_difference(
            log.truth, np.array([s.truth.array() for s in made.samples if s.truth])
        )
    else:
        assert log.truth is None
    assert not first_difference(log.commands, (*(step.command for step in made.steps), made.stop))


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 5),
    steps=st.integers(1, 8),
    simulated=st.booleans(),
    length=st.integers(2, 12),
)
def test_a_trial_comes_back_bit_for_bit(tmp_path_factory, seed, robots, steps, simulated, length):
    made = trial(
        seed, robots=robots, steps=steps, simulated=simulated, length=length, first=min(length, 5)
    )
    path = write(made, tmp_path_factory.mktemp("log") / "trial.mcap")
    assert_same_trial(read_trial(path), made)


def test_commands_outside_the_steps_are_kept_apart_from_them(tmp_path):
    made = trial(steps=1)
    square = Command(Steer(1.25), 17, (True, False, True))
    with LogWriter(tmp_path / "trial.mcap") as writer:
        writer.on_start(made.start)
        writer.on_command(square)
        made.give_rounds(writer)
        writer.on_stop(made.stop, made.result)
    log = read_trial(tmp_path / "trial.mcap")
    assert not first_difference(log.commands, (square, made.steps[0].command, made.stop))
    assert not first_difference(log.steps, tuple(made.steps))
    assert not first_difference(log.stop, made.stop)


def test_the_result_is_read_without_the_course(tmp_path):
    made = trial(index=2)
    path = write(made, tmp_path / "trial.mcap")
    summary = read_result(path)
    assert not first_difference(summary.result, made.result)
    assert (summary.trial, summary.seed) == (2, 2**64 - 1)
    assert (summary.experiment, summary.simulated) == (made.experiment, True)
    assert summary.digest == read_trial(path).digest
    assert not summary.recovered


def test_an_outcome_that_logs_call_by_its_first_name_is_read_by_its_present_one(tmp_path):
    """So that digests stay as they are, and older logs are read and verified."""
    made = trial(1, steps=1)
    ended = replace(made.result, outcome=Outcome.NO_BETTER_PLAN, reason="")
    path = write(replace(made, result=ended), tmp_path / "trial.mcap")
    assert b"nothing better" in scan(path).by_topic[RESULT][0].data
    assert read_result(path).outcome is Outcome.NO_BETTER_PLAN
    log = read_trial(path)
    assert log.notes[-1].text == "nothing better after 1 control steps"
    assert log.events[-1].text == "no better plan after 1 control steps"


@pytest.mark.parametrize("former", ["nearing", "leaving a corner"])
def test_a_state_of_an_earlier_version_is_read_as_driving(former):
    step = trial(robots=2, steps=1).steps[0]
    message = codec.encode_step(step, codec.encode_command(step.command))
    message.state = former
    assert codec.decode_step(message, None, robots=2).plan.state is State.DRIVING
