"""The trial digest: a hash of a trial's records, independent of how a log stores them.

The content digest covers the bytes of a log, including messages for viewers. The trial digest
covers only the records: a running trial (`Recorder`) and its log have the same trial digest, so
that a study's row can state it even without a log.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator

from google.protobuf.message import Message

from tetractl.core.errors import printable
from tetractl.core.trial import TrialRecords
from tetractl.log.format import codec
from tetractl.log.format.channels import TEXT
from tetractl.log.format.metadata import result_metadata, run_metadata

BLOCK = 10_000  # frames encoded at a time


def trial_digest(trial: TrialRecords) -> str:
    """Return SHA-256 over the records of a trial except the solve times.

    Frames, commands, control steps with their estimates, and operator messages each have a hash of
    their encoded messages in order; the digest covers these hashes, the start and the result.
    Operator messages are hashed as read from a log: shortened, with unprintable characters escaped.
    The digest of a damaged log differs from the trial's.
    """
    start, result = trial.start, trial.result
    ended = {}
    if result is not None:
        ended = result_metadata(result, start.setup.unit)
        ended["reason"] = printable(result.reason, TEXT)
    texts = [start.spec_text, start.resolved, *start.attached]
    notes = [(one.t_ns, one.level, printable(one.text, TEXT)) for one in trial.notes]
    parts = (
        [json.dumps([run_metadata(start), texts, notes, ended], sort_keys=True).encode()],
        map(_bytes, _frames(trial)),
        map(_bytes, map(codec.encode_command, trial.commands)),
        map(_bytes, _steps(trial)),
    )
    return hashlib.sha256(b"".join(map(_hash, parts))).hexdigest()


def _frames(trial: TrialRecords) -> Iterator[Message]:
    frames = codec.Frames(
        trial.frames, trial.mocap_ns, trial.received_ns, trial.mocap, trial.valid, trial.truth
    )
    for begin in range(0, len(trial.frames), BLOCK):
        yield codec.encode_frames(frames.part(slice(begin, begin + BLOCK)))


def _steps(trial: TrialRecords) -> Iterator[Message]:
    for step in trial.steps:
        yield codec.encode_step(step)
        if step.plan.estimate is not None:
            yield codec.encode_estimate(step.k, step.plan.estimate)


def _bytes(message: Message) -> bytes:
    return message.SerializeToString(deterministic=True)


def _hash(parts: Iterable[bytes]) -> bytes:
    found = hashlib.sha256()
    for part in parts:
        found.update(b"%d:%b" % (len(part), part))
    return found.digest()
