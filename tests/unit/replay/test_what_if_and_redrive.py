"""Other decisions on recorded observations, and recorded commands driven again."""

from dataclasses import replace

import numpy as np
import pytest
from support.trials import cut_short, three_robots

from tetractl.core.errors import UsageError
from tetractl.experiment.load import LoadedSpec
from tetractl.replay.open_loop import (
    other_experiment,
    paths_apart,
    recorded_directions,
    sequence_spec,
    what_if,
)


def test_the_same_controller_decides_the_same():
    log = cut_short(three_robots(), 5)
    found = what_if(log, other_experiment(log, ["controller.steps_max=100"]))
    assert (len(found.steps), found.changed, found.ended) == (5, 0, "")
    assert all((step.apart == 0).all() for step in found.steps)
    assert [step.recorded for step in found.steps] == [s.command.direction for s in log.steps]


def test_another_controller_decides_otherwise_on_the_recorded_observations():
    log = cut_short(three_robots(), 5)
    first, *_ = what_if(log, other_experiment(log, ["controller.horizon_max=3"])).steps
    assert first.recorded_length > 3 >= first.other_length
    ends = first.apart
    assert ends.shape == (3,) and ends.max() > 100  # mm: three signals do not reach the targets
    assert first.other_error > first.recorded_error


def test_where_the_other_controller_would_have_ended_the_trial_is_told():
    log = cut_short(three_robots(), 5)
    found = what_if(log, other_experiment(log, ["controller.steps_max=2"]))
    assert len(found.steps) == 3
    assert found.ended == "at step 3 the other controller would have ended the trial: steps max"


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("plant.dead_time=0.1", "only fields of 'controller'"),
        ("controller.period=0.1", "differs from the recorded 0.2"),
    ],
)
def test_what_cannot_be_replaced_in_a_log_is_refused(setting, says):
    with pytest.raises(UsageError, match=says):
        other_experiment(three_robots(), [setting])


def test_recorded_directions_are_those_of_the_steps():
    log = three_robots()
    directions, remainder = recorded_directions(log)
    assert directions.tolist() == [step.command.direction for step in log.steps]
    assert remainder == 0.0


@pytest.mark.parametrize(("late_ms", "held"), [(80, 3), (120, 2)])
def test_a_late_direction_counts_from_the_nearest_period_on(late_ms, held):
    log = three_robots()
    late = replace(log.commands[3], sent_ns=log.commands[3].sent_ns + late_ms * 1_000_000)
    commands = (*log.commands[:3], late, *log.commands[4:])
    directions, _ = recorded_directions(replace(log, commands=commands))
    sent = [step.command.direction for step in log.steps]
    assert directions.tolist() == [*sent[:3], sent[held], *sent[4:]]


def test_a_spec_of_a_sequence_sends_it_and_is_complete():
    log = three_robots()
    spec = LoadedSpec(log.experiment, log.start.spec_text, log.start.spec_name)
    made = sequence_spec(spec, np.array([0.1, -0.2]), 0.05)
    controller = made.experiment.controller
    assert (controller.type, controller.directions) == ("sequence", (0.1, -0.2))
    assert controller.remainder == 0.05
    assert made.experiment.robots == log.experiment.robots


def test_paths_are_compared_at_the_recorded_frames():
    log = three_robots()
    shifted = replace(log, mocap=log.mocap + np.array([3.0, 4.0, 0.0]))
    apart = paths_apart(log, shifted)
    assert np.nanmin(apart.distance) == pytest.approx(5)
    assert np.nanmax(apart.distance) == pytest.approx(5)
    assert apart.final == pytest.approx([5, 5, 5])
    assert apart.time_s[0] == 0
    assert paths_apart(log, log).distance.max() == pytest.approx(0, abs=1e-9)
