"""Copy the intact records of a damaged log to a complete file."""

import hashlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment

from tetractl.core.errors import LogError
from tetractl.log.format.channels import RECOVERED, Entry
from tetractl.log.format.tetractl_pb2 import Recovered
from tetractl.log.read.find import LOG_PART, RECOVERED_SUFFIX, SUFFIX
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import Damage, TrialLog, frame_gaps, step_gaps
from tetractl.log.write.sink import Sink

PART_SUFFIX = ".recovering"
"""Suffix of an unfinished copy, which is not a log. The next recovery replaces it."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """The result of an attempt to save the intact part of a damaged log.

    Attributes:
        source: Path of the damaged log.
        path: Path of the copy of its intact records. None if nothing was copied.
        chunks: Number of intact chunks.
        messages: Number of intact messages.
        attachments: Number of intact attachments.
        damage: The damage of the log.
    """

    source: str
    path: str | None
    chunks: int
    messages: int
    attachments: int
    damage: Damage

    @property
    def whole(self) -> bool:
        """Whether all records of the log are intact."""
        return not self.damage.lost


def recovered_path(log: Path) -> Path:
    """Return the default path of a recovered log, next to the damaged one.

    For example, it is trial-003.recovered.mcap for trial-003.mcap.part.
    """
    for suffix in (LOG_PART, SUFFIX):
        if log.name.endswith(suffix):
            return log.with_name(log.name.removesuffix(suffix) + RECOVERED_SUFFIX)
    return log.with_name(log.name + RECOVERED_SUFFIX)


def recover(log: Path, out: Path | None = None) -> Recovery:
    """Write every intact chunk and attachment of a log to a complete file.

    An unfinished copy of an earlier call is replaced.

    Args:
        log: Path of the log.
        out: Path of the complete file. By default, `recovered_path` if the log is damaged. An
            undamaged log is not copied by default.

    Raises:
        LogError: If nothing can be read, if the file exists already, or if another process is
            writing the file.
    """
    contents = scan(log)
    if not contents.records:
        raise LogError(f"{log}: the log is damaged, and nothing in it can be recovered")
    damage = _examine(contents)
    path = out or (recovered_path(log) if damage.problems or damage.lost else None)
    if path is not None:
        _write(contents, damage, path)
    counts = Counter(map(type, contents.records))
    return Recovery(
        source=str(log),
        path=None if path is None else str(path),
        chunks=contents.chunks,
        messages=counts[Entry],
        attachments=counts[Attachment],
        damage=damage,
    )


def _examine(contents: RawLog) -> Damage:
    """Find the problems of a log, and what it has lost."""
    try:
        trial = trial_of(contents)
    except LogError as error:
        problem = error.message.removeprefix(f"{contents.path}: ")
        lost = (*contents.lost, "records without which a log cannot be read")
        return Damage((*contents.problems, problem), lost)
    problems = trial.damage.problems if trial.damage else ()
    return Damage(problems, losses(contents, trial))


def losses(raw_log: RawLog, trial: TrialLog) -> tuple[str, ...]:
    """Describe the lost records of a log, one sentence each.

    The result is empty if nothing is lost: the log's records match both digests stored in it, and
    the log was not recovered from a log that had lost records.
    """
    lost = trial.damage.lost if trial.damage else ()
    if trial.digest and not raw_log.altered and not raw_log.host_altered:
        return lost if raw_log.recovered else ()
    gaps = [*frame_gaps(trial), *step_gaps(trial)]
    lost += tuple(map(str, gaps))
    if trial.stop is None:
        lost += ("the stop command at the end of the trial",)
    return lost or ("at least one record, because a digest in the log does not match",)


def _write(contents: RawLog, damage: Damage, path: Path) -> None:
    sink = Sink(path, PART_SUFFIX, contents.channels)
    with contents.path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    recovered = Recovered(
        source=contents.path.name,
        source_bytes=contents.size,
        source_sha256=digest,
        problems=damage.problems,
        lost=damage.lost,
    )
    try:
        for record in contents.records:
            if isinstance(record, Attachment) or record.topic != RECOVERED:
                sink.add(record)
        last_ns = max((entry.log_ns for entry in contents.entries), default=0)
        sink.add(Entry(RECOVERED, last_ns, last_ns, recovered.SerializeToString()))
        sink.close(complete=True)
    except BaseException:  # such as a full disk: remove the copy, the source is unchanged
        sink.discard()
        raise
