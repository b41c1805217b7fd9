"""The digest of a trial: the same from the records as they are made and from the log read back,
and another one for any other record."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.random_trials import trial, write

from tetractl.core.commands import FieldOff, Note, Sample
from tetractl.core.errors import printable
from tetractl.core.plan import Estimate, Outcome
from tetractl.core.poses import Poses
from tetractl.log.format.channels import TEXT
from tetractl.log.format.trial_digest import trial_digest
from tetractl.log.read.reader import read_trial
from tetractl.log.write.recorder import Recorder


def records(made):
    """The records of a trial as its loop would emit them."""
    writer = Recorder()
    writer.on_start(made.start)
    made.give_rounds(writer)
    writer.on_stop(made.stop, made.result)
    return writer.trial


def digest(made):
    return trial_digest(records(made))


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 5),
    steps=st.integers(1, 6),
    simulated=st.booleans(),
)
def test_the_log_of_a_trial_gives_its_digest(tmp_path_factory, seed, robots, steps, simulated):
    made = trial(seed, robots=robots, steps=steps, simulated=simulated)
    path = write(made, tmp_path_factory.mktemp("log") / "trial.mcap")
    assert trial_digest(read_trial(path)) == digest(made)


def test_every_record_counts():
    """That all of a record does follows from the messages, which give it back bit for bit."""
    made = trial(steps=2, frames=2, robots=2, first=2, iterations=2, length=3)
    whole = records(made)
    sample, step = whole.mocap.copy(), whole.steps[1]
    sample[1, 1, 2] = np.nextafter(sample[1, 1, 2], 9)
    estimate = Estimate(*(np.array([1.5, 2.5]) + i for i in range(6)), 0.1, 0.01)
    later = replace(step, plan=replace(step.plan, estimate=replace(estimate, dead_time=0.2)))
    step = replace(step, plan=replace(step.plan, estimate=estimate))
    found = [
        trial_digest(replace(whole, **fields))
        for fields in (
            {},
            {"mocap": sample},
            {"valid": ~whole.valid},
            {"truth": None},
            {"frames": whole.frames + 1},
            {"commands": whole.commands[:-1]},
            {"commands": (*whole.commands[:-1], replace(made.stop, action=FieldOff()))},
            {"steps": whole.steps[:1]},
            {"steps": (whole.steps[0], step)},
            {"steps": (whole.steps[0], later)},
            {"notes": whole.notes[1:]},
            {"start": replace(whole.start, seed=5)},
            {"start": replace(whole.start, attached=(("a", "b"),))},
            {"result": None},
            {"result": replace(made.result, total_error=1.0)},
        )
    ]
    assert len(set(found)) == len(found)
    slow = replace(whole.steps[1], solve_ns=7, deadline_missed=True)
    assert trial_digest(replace(whole, steps=(whole.steps[0], slow))) == found[0]


TEXTS = ("solver:\n  none", "\x1b[2J", "x" * 1999 + "\n", "y" * 2001, "nbsp\xa0", "\udce9")


@pytest.mark.parametrize("text", TEXTS)
def test_texts_are_hashed_as_a_log_gives_them_back(tmp_path, text):
    made = trial(steps=2)
    written = text.encode(errors="replace").decode() if "\udce9" in text else text
    made = replace(made, result=replace(made.result, outcome=Outcome.ABORTED, reason=written))
    path = write(made, tmp_path / "trial.mcap")
    assert trial_digest(read_trial(path)) == digest(made)
    noted, shown = (
        replace(records(made), notes=(Note(0, "info", t),)) for t in (text, printable(text, TEXT))
    )
    assert trial_digest(noted) == trial_digest(shown)


def test_a_plugins_arrays_may_be_of_any_type(tmp_path):
    made = trial(steps=1)
    ((samples, step),) = made.rounds
    seen = samples[0].observation
    columns = (seen.poses.x, seen.poses.y, seen.poses.heading)
    poses = Poses(*(np.rint(column).astype(np.int32) for column in columns))
    seen = replace(seen, poses=poses, valid=seen.valid.astype(np.int64))
    command = replace(step.command, delivered=tuple(np.array(step.command.delivered)))
    searches = tuple(replace(search, stopped="because\n" * 20) for search in step.plan.searches)
    plan = replace(step.plan, searches=searches, path=step.plan.path.astype(np.float32))
    step = replace(step, command=command, plan=plan)
    samples = [Sample(seen, samples[0].truth), *samples[1:]]
    made = replace(made, rounds=[(samples, step)])
    path = write(made, tmp_path / "trial.mcap")
    assert trial_digest(read_trial(path)) == digest(made)
