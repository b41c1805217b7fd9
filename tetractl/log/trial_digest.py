"""The digest of a trial: a hash of its records, however and wherever a log stores them.

A content digest is over the bytes of a log, with the messages that only repeat for Foxglove what
others hold. A study keeps trials without logs, and would spend a quarter of their time on encoding
for a hash: its rows state this digest, which a trial as it runs and its log read back both give.
"""

import hashlib
from collections.abc import Iterable, Mapping
from struct import pack

import numpy as np

from tetractl.core.commands import Command, Note, Sample
from tetractl.core.plan import Estimate, Plan
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.text import printable
from tetractl.core.trial import Result, Start, Step
from tetractl.log.format.metadata import FORMAT, result_metadata, run_metadata
from tetractl.log.read.bounds import TEXT
from tetractl.log.read.trial_log import TrialLog

FLOAT64 = np.dtype("<f8")


class TrialDigest:
    """SHA-256 over the records of one trial of N robots but the times of solving.

    Frames, commands, control steps and messages for people each have a hash of their own, in their
    order; the digest is over those and over start and result, so that it makes no difference how
    the kinds follow one another. Numbers are hashed as little-endian float64 and int64.
    """

    def __init__(self, start: Start) -> None:
        self._unit = start.setup.unit
        stated = run_metadata(start)
        del stated[FORMAT]  # how a log stores a trial is none of its records
        self._first = hashlib.sha256(_items(stated))
        attached = [text for pair in start.attached for text in pair]
        for text in (start.spec_text, start.resolved, *attached):
            self._first.update(_text(text))
        self._frames, self._commands = hashlib.sha256(), hashlib.sha256()
        self._steps, self._notes = hashlib.sha256(), hashlib.sha256()

    def samples(self, samples: Iterable[Sample]) -> None:
        """Add camera frames, with the true poses where they are known."""
        self._frames.update(b"".join([_sample(sample) for sample in samples]))

    def command(self, command: Command) -> None:
        """Add a command: of a control step, between two, or the stop."""
        self._commands.update(
            pack("<q??", command.sent_ns, command.stops, command.field_off)
            + bytes(command.delivered)
            + _numbers(command.direction, command.left, command.right)
        )

    def step(self, step: Step) -> None:
        """Add a control step: what was observed and decided, without its command."""
        self._steps.update(pack("<q", step.k) + _observation(step.observation) + _plan(step.plan))

    def note(self, note: Note) -> None:
        """Add a message for people, as text that a terminal can show."""
        text = printable(note.text, TEXT)
        self._notes.update(pack("<q", note.t_ns) + _text(note.level) + _text(text))

    def digest(self, result: Result | None) -> str:
        """Return the digest of the trial with its result, None where it has none."""
        last = hashlib.sha256(_items(result_metadata(result, self._unit)) if result else b"")
        kinds = (self._first, self._frames, self._commands, self._steps, self._notes, last)
        return hashlib.sha256(b"".join([kind.digest() for kind in kinds])).hexdigest()


def trial_digest(trial: TrialLog) -> str:
    """Return the digest of a trial that was read from its log."""
    digest = TrialDigest(trial.start)
    digest.samples(_samples(trial))
    for command in trial.commands:
        digest.command(command)
    for step in trial.steps:
        digest.step(step)
    for note in trial.notes:
        digest.note(note)
    return digest.digest(trial.result)


def _samples(trial: TrialLog) -> Iterable[Sample]:
    numbers = zip(trial.frames, trial.mocap_ns, trial.received_ns, strict=True)
    for i, (frame, sampled_ns, received_ns) in enumerate(numbers):
        poses, valid = Poses.of(trial.mocap[i]), trial.valid[i]
        seen = Observation(int(frame), int(sampled_ns), int(received_ns), poses, valid)
        yield Sample(seen, None if trial.truth is None else Poses.of(trial.truth[i]))


def _sample(sample: Sample) -> bytes:
    truth = b"" if sample.truth is None else _poses(sample.truth)
    return _observation(sample.observation) + truth


def _observation(seen: Observation) -> bytes:
    head = pack("<qqq", seen.frame, seen.sampled_ns, seen.received_ns)
    return head + _poses(seen.poses) + seen.valid.tobytes()


def _poses(poses: Poses) -> bytes:
    return _bytes(poses.x) + _bytes(poses.y) + _bytes(poses.heading)


def _plan(plan: Plan) -> bytes:
    costs = (plan.cost, plan.target_cost, plan.obstacle_cost)
    parts = [
        pack("<qQ?", plan.chosen, plan.generator, plan.field_off),
        _numbers(*costs, plan.signals, plan.path, *_estimate(plan.estimate)),
    ]
    for search in plan.searches:
        parts.append(pack("<qq", search.length, search.evaluations) + _text(search.stopped))
        parts.append(_numbers(search.cost, search.signals, search.history))
    return b"".join(parts)


def _estimate(estimate: Estimate | None) -> tuple[Floats | float | None, ...]:
    if estimate is None:
        return ()
    return (
        *(estimate.a, estimate.a_std, estimate.speed, estimate.speed_std),
        *(estimate.heading_bias, estimate.heading_bias_std),
        *(estimate.dead_time, estimate.dead_time_std),
    )


def _numbers(*values: Floats | float | None) -> bytes:
    """Return numbers and arrays of them, each after its count; -1 for None."""
    parts = [pack("<q", len(values))]
    for value in values:
        if value is None:
            parts.append(pack("<q", -1))
        else:
            data = _bytes(value)
            parts += (pack("<q", len(data) // FLOAT64.itemsize), data)
    return b"".join(parts)


def _bytes(value: Floats | float) -> bytes:
    """Return numbers as a log stores them, whatever a plugin's arrays are of."""
    return np.asarray(value, dtype=FLOAT64).tobytes()


def _items(items: Mapping[str, str]) -> bytes:
    return b"".join([_text(text) for pair in sorted(items.items()) for text in pair])


def _text(text: str) -> bytes:
    data = text.encode(errors="replace")
    return pack("<q", len(data)) + data
