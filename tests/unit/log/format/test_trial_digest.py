"""The digest of a trial: the same from the records as they are made and from the log read back,
and another one for any other record."""

import dataclasses
from dataclasses import replace
from enum import Enum
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.random_trials import Made, trial, write

from tetractl.core.commands import Note, Sample
from tetractl.core.plan import Estimate, Outcome
from tetractl.core.poses import Poses
from tetractl.core.text import printable
from tetractl.core.trial import TrialRecords
from tetractl.log.format.channels import TEXT
from tetractl.log.format.trial_digest import trial_digest
from tetractl.log.read.reader import read_trial
from tetractl.log.write.recorder import Recorder

HOST = {"solve_ns", "deadline_missed", "deadline_misses", "packages"}
SETUP = {"setup", "start_unix_ns"}  # given by the text of the spec and by its hash
TOLD = {"not_at_rest", "field_off", "pauses"}  # by the reason of the result, and by the command
OTHERS = {Outcome.SEQUENCE_COMPLETED: Outcome.ARRIVED}


def records(made: Made) -> TrialRecords:
    """The records of a trial as its loop would emit them."""
    writer = Recorder()
    writer.on_start(made.start)
    for samples, step in made.rounds:
        writer.on_samples(samples)
        writer.on_step(step)
    writer.on_stop(made.stop, made.result)
    return writer.trial


def digest(made: Made) -> str:
    return trial_digest(records(made))


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    robots=st.integers(1, 5),
    steps=st.integers(1, 6),
    simulated=st.booleans(),
)
def test_the_log_of_a_trial_gives_its_digest(
    tmp_path_factory: pytest.TempPathFactory, seed: int, robots: int, steps: int, simulated: bool
) -> None:
    made = trial(seed, robots=robots, steps=steps, simulated=simulated)
    path = write(made, tmp_path_factory.mktemp("log") / "trial.mcap")
    assert trial_digest(read_trial(path)) == digest(made)


def others(record):
    """Every record that differs in one number or text from a record, with the way to it."""
    if dataclasses.is_dataclass(record):
        for field in dataclasses.fields(record):
            if field.name not in HOST | SETUP | TOLD:
                for way, other in others(getattr(record, field.name)):
                    yield f"{field.name}.{way}", replace(record, **{field.name: other})
    elif isinstance(record, np.ndarray):
        for i in np.ndindex(record.shape):
            other = record.copy()
            other[i] = ~other[i] if other.dtype == bool else np.nextafter(other[i], np.inf)
            yield str(i), other
    elif isinstance(record, tuple):
        for i, item in enumerate(record):
            for way, other in others(item):
                yield f"{i}.{way}", (*record[:i], other, *record[i + 1 :])
    elif isinstance(record, bool):
        yield "", not record
    elif isinstance(record, Enum):
        yield "", OTHERS.get(record, str(record) + "?")
    elif isinstance(record, int):
        yield "", record ^ 1
    elif isinstance(record, float):
        yield "", float(np.nextafter(record, -np.inf))
    elif isinstance(record, str):
        yield "", record + "?"


def test_any_other_number_gives_another_digest():
    made = trial(steps=2, frames=2, robots=2, first=2, iterations=2, length=3)
    samples, step = made.rounds[1]
    numbers = np.array([1.5, 2.5])
    estimate = Estimate(*(numbers + i for i in range(6)), 0.1, 0.01)
    step = replace(step, plan=replace(step.plan, estimate=estimate))

    def again(samples=samples, step=step, **fields):
        return digest(replace(made, rounds=[made.rounds[0], (samples, step)], **fields))

    seen = {again(): "the trial itself"}
    tried = [
        *((f"sample.{way}", again(samples=[samples[0], o])) for way, o in others(samples[1])),
        *((f"step.{way}", again(step=o)) for way, o in others(step)),
        *((f"stop.{way}", again(stop=o)) for way, o in others(made.stop)),
        *((f"start.{way}", again(start=o)) for way, o in others(made.start)),
        *((f"result.{way}", again(result=o)) for way, o in others(made.result)),
        ("no estimate", again(step=replace(step, plan=replace(step.plan, estimate=None)))),
        ("no truth", again(samples=[replace(s, truth=None) for s in samples])),
        ("a frame less", again(samples=samples[1:])),
        ("the field off", again(stop=replace(made.stop, field_off=True))),
    ]
    for way, found in tried:
        assert found not in seen, f"{way} gives the digest of {seen[found]}"
        seen[found] = way
    assert len(tried) > 150


TEXTS = ("solver:\n  none", "\x1b[2J", "x" * 1999 + "\n", "y" * 2001, "nbsp\xa0", "\udce9")


@pytest.mark.parametrize("text", TEXTS)
def test_texts_are_hashed_as_a_log_gives_them_back(tmp_path: Path, text: str):
    made = trial(steps=2)
    written = text.encode(errors="replace").decode() if "\udce9" in text else text
    made = replace(made, result=replace(made.result, outcome=Outcome.ABORTED, reason=written))
    path = write(made, tmp_path / "trial.mcap")
    assert trial_digest(read_trial(path)) == digest(made)
    noted, shown = (
        replace(records(made), notes=(Note(0, "info", t),)) for t in (text, printable(text, TEXT))
    )
    assert trial_digest(noted) == trial_digest(shown)


def test_a_plugins_arrays_may_be_of_any_type(tmp_path: Path):
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


def test_a_digest_is_that_of_earlier_versions():
    """A study goes on with the rows that it has."""
    made = trial(steps=2, frames=2, robots=2, first=2, iterations=2, length=3)
    start = replace(made.start, resolved="a: 1\n", spec_hash="0" * 64)  # a spec may get new fields
    found = digest(replace(made, start=start))
    assert found == "15ab1ccdeef938f238fa3829215f36af55019dd8cb6dd77d2d809b098550b5c8"
