"""A trial kept in memory is the trial that its log contains."""

from dataclasses import fields

import numpy as np
from testkit.trials import DISTURBED, THREE_M3PI

from tetractl.core.loggable import round_for_drawing
from tetractl.log.read.reader import read_trial
from tetractl.log.recorder import TrialRecorder
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import parse_contents
from tetractl.verification.comparison import first_difference

LOSSES = [{"type": "tracking-loss", "every": 2, "duration": 0.1}, {"type": "radio", "loss": 0.2}]
NOT_THE_SAME = {"log", "digest", "facts", "truth", "steps"}
"""The fields that differ, or that a log rounds."""


def both(folder, contents, *settings):
    """The same trial as its log has it, and as the recorder has kept it."""
    recorder = TrialRecorder()
    spec = parse_contents(contents, "three.yaml", settings)
    run_logged(spec, folder, observers=[recorder])
    return read_trial(log_path(folder, 0)), recorder.trial_log("trial 0")


def test_a_trial_in_memory_equals_the_trial_of_its_log(tmp_path):
    plant = DISTURBED["plant"] | {"disturbances": LOSSES}
    logged, kept = both(tmp_path, THREE_M3PI | {"plant": plant})
    texts = [note.text for note in kept.notes]
    assert any(text.endswith("is tracked again") for text in texts)
    assert any("did not get the command of step" in text for text in texts)
    names = [column.name for column in fields(logged) if column.name not in NOT_THE_SAME]
    different = [
        name for name in names if first_difference(getattr(logged, name), getattr(kept, name))
    ]
    assert different == []
    assert np.array_equal(logged.truth, kept.truth.astype(np.float32))
    for logged_step, step in zip(logged.steps, kept.steps, strict=True):
        assert not first_difference(logged_step.command, step.command)
        assert not first_difference(logged_step.observation, step.observation)
        assert np.array_equal(
            logged_step.plan.path[..., :2], round_for_drawing(step.plan.path[..., :2])
        )
        assert np.array_equal(logged_step.plan.signals, step.plan.signals)
    assert [event.text for event in logged.events] == [event.text for event in kept.events]


def test_what_belongs_to_a_file_is_left_out(tmp_path):
    logged, kept = both(tmp_path, THREE_M3PI, "controller.steps_max=2")
    assert (logged.log, kept.log) == (str(log_path(tmp_path, 0)), "trial 0")
    assert logged.digest
    assert kept.digest is None
    assert logged.facts["python"]
    assert kept.facts == {}
    assert kept.damage is None
