"""Tests that a log is read exactly as it was written, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testkit.random_trials import trial, write

from tetractl.core.commands import Command, Steer
from tetractl.core.plan import Outcome, State
from tetractl.log.format import codec
from tetractl.log.format.channels import RESULT
from tetractl.log.read.reader import read_result, read_trial
from tetractl.log.read.salvage import scan
from tetractl.log.write.writer import LogWriter
from tetractl.verification.comparison import first_difference


def assert_same_trial(log, random_trial):
    assert log.damage is None
    assert not first_difference(log.start, random_trial.start)
    assert not first_difference(log.steps, tuple(random_trial.steps))
    assert not first_difference(log.stop, random_trial.stop)
    assert not first_difference(log.result, random_trial.result)
    assert log.start.seed == random_trial.experiment.trials.seed
    commands = [step.command for step in random_trial.steps]
    assert not first_difference(log.commands, (*commands, random_trial.stop))
    assert_same_frames(log, random_trial)


def assert_same_frames(log, random_trial):
    observations = [sample.observation for sample in random_trial.samples]
    numbers = np.array([o.frame for o in observations], dtype=np.int64)
    sampled_ns = np.array([o.sampled_ns for o in observations], dtype=np.int64)
    received_ns = np.array([o.received_ns for o in observations], dtype=np.int64)
    poses = np.array([o.poses.array() for o in observations])
    valid = np.array([o.valid for o in observations])
    truth = None
    if random_trial.start.plant.simulated:
        truth = np.array([sample.truth.array() for sample in random_trial.samples])
    assert not first_difference(log.frames, numbers)
    assert not first_difference(log.mocap_ns, sampled_ns)
    assert not first_difference(log.received_ns, received_ns)
    assert not first_difference(log.mocap, poses)
    assert not first_difference(log.valid, valid)
    assert not first_difference(log.truth, truth)


@pytest.mark.long
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 5),
    steps=st.integers(1, 8),
    simulated=st.booleans(),
    length=st.integers(2, 12),
)
def test_a_trial_comes_back_bit_for_bit(tmp_path_factory, seed, robots, steps, simulated, length):
    random_trial = trial(
        seed, robots=robots, steps=steps, simulated=simulated, length=length, first=min(length, 5)
    )
    path = write(random_trial, tmp_path_factory.mktemp("log") / "trial.mcap")
    assert_same_trial(read_trial(path), random_trial)


def test_commands_outside_the_steps_are_kept_apart_from_them(tmp_path):
    random_trial = trial(steps=1)
    square = Command(Steer(1.25), 17, (True, False, True))
    with LogWriter(tmp_path / "trial.mcap") as writer:
        writer.on_start(random_trial.start)
        writer.on_command(square)
        random_trial.give_rounds(writer)
        writer.on_stop(random_trial.stop, random_trial.result)
    log = read_trial(tmp_path / "trial.mcap")
    assert not first_difference(
        log.commands, (square, random_trial.steps[0].command, random_trial.stop)
    )
    assert not first_difference(log.steps, tuple(random_trial.steps))
    assert not first_difference(log.stop, random_trial.stop)


def test_an_outcome_that_logs_call_by_its_first_name_is_read_by_its_present_one(tmp_path):
    """So that digests stay as they are, and older logs are read and verified."""
    random_trial = trial(1, steps=1)
    ended = replace(random_trial.result, outcome=Outcome.NO_BETTER_PLAN, reason="")
    path = write(replace(random_trial, result=ended), tmp_path / "trial.mcap")
    assert b"nothing better" in scan(path).entries_by_topic[RESULT][0].data
    assert read_result(path).outcome is Outcome.NO_BETTER_PLAN
    log = read_trial(path)
    assert log.notes[-1].text == "nothing better after 1 control steps"
    assert log.events[-1].text == "no better plan after 1 control steps"


def test_the_result_is_read_without_the_course(tmp_path):
    random_trial = trial(index=2)
    path = write(random_trial, tmp_path / "trial.mcap")
    summary = read_result(path)
    assert not first_difference(summary.result, random_trial.result)
    assert (summary.trial, summary.seed) == (2, 2**64 - 1)
    assert (summary.experiment, summary.simulated) == (random_trial.experiment, True)
    assert summary.digest == read_trial(path).digest
    assert not summary.recovered


@pytest.mark.parametrize("former", ["nearing", "leaving a corner"])
def test_a_state_of_an_earlier_version_is_read_as_driving(former):
    step = trial(robots=2, steps=1).steps[0]
    message = codec.encode_step(step, codec.encode_command(step.command))
    message.state = former
    assert codec.decode_step(message, None, n_robots=2).plan.state is State.DRIVING
