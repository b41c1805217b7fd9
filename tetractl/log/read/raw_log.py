"""The contents of a log file, record by record.

The records show which trial it is, how the trial ended, and whether the content is unchanged.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from google.protobuf.message import DecodeError
from mcap.records import Attachment, Channel, Schema

from tetractl.core.errors import LogError, printable
from tetractl.core.trial import Result
from tetractl.log.format import channels
from tetractl.log.format.channels import Entry, Record
from tetractl.log.format.digest import LogDigests
from tetractl.log.format.run_records import decode_facts
from tetractl.log.format.tetractl_pb2 import Digests, Run
from tetractl.log.read.limits import file_limit, limit_error
from tetractl.log.read.trial_log import Damage
from tetractl.log.read.validate import stated_result

ALTERED_TEXT = "the content of the log does not match the digest stated in it"
UNKNOWN_PROGRAM = "an unknown program"
BEFORE_ATTACHMENTS = (channels.RUN, channels.HOST)
"""Topics of the messages that tetractl writes before the first attachment."""


@dataclass(frozen=True)
class RawLog:
    """The intact records of a log file.

    A log ends with two digests that its writer has computed, one of the content and one of the host
    records. If the digests of the records in the file differ from these, the log was altered.

    Attributes:
        path: Path of the file.
        size: Size of the file [bytes].
        records: The intact messages and attachments, in file order.
        chunks: Number of intact chunks.
        problems: Damaged records of the file. Empty for an undamaged file.
        lost: Descriptions of lost records. Empty for an undamaged file.
        channels: The recorded channels with their schemas, by topic.
        library: Name of the program that wrote the file.
        has_loose_messages: Whether the file has messages outside chunks.
    """

    path: Path
    size: int = 0
    records: list[Record] = field(default_factory=list)
    chunks: int = 0
    problems: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    channels: dict[str, tuple[Channel, Schema | None]] = field(default_factory=dict)
    library: str = ""
    has_loose_messages: bool = False

    @cached_property
    def entries(self) -> list[Entry]:
        """All messages of the log, in the order of the file."""
        return [record for record in self.records if isinstance(record, Entry)]

    @cached_property
    def entries_by_topic(self) -> dict[str, list[Entry]]:
        """The messages of each topic of the log, in the order of the file."""
        entries_by_topic: dict[str, list[Entry]] = defaultdict(list)
        for entry in self.entries:
            entries_by_topic[entry.topic].append(entry)
        return entries_by_topic

    @cached_property
    def attachments(self) -> dict[str, Attachment]:
        """The attachments by name. If two have the same name, the first attachment counts."""
        by_name: dict[str, Attachment] = {}
        for record in self.records:
            if isinstance(record, Attachment):
                by_name.setdefault(record.name, record)
        return by_name

    def attachment_text(self, name: str) -> str | None:
        """Return the contents of the attachment with this name as text.

        The result is None if the attachment is missing.
        """
        attachment = self.attachments.get(name)
        return None if attachment is None else attachment.data.decode(errors="replace")

    def messages(self, topic: str) -> Iterator[Any]:
        """Decode the messages of a topic one by one, in the order of the file.

        Raises DecodeError at a message that cannot be decoded.
        """
        decode = channels.CHANNELS[topic].FromString
        return (decode(entry.data) for entry in self.entries_by_topic[topic])

    def _first_message(self, topic: str) -> Any:
        """Return the first message of a topic, or an empty message if it is lost or unreadable."""
        with suppress(DecodeError, ValueError):
            return next(self.messages(topic), channels.CHANNELS[topic]())
        return channels.CHANNELS[topic]()

    @cached_property
    def run(self) -> Run:
        """The message `/run` of the log, which identifies the trial.

        Raises:
            LogError: If the message is lost, unreadable or of another format.
        """
        if not self.entries_by_topic[channels.RUN]:
            raise self._missing_run_error()
        try:
            run = next(self.messages(channels.RUN))
        except (DecodeError, ValueError) as error:
            problem = f"the record of the run cannot be read: {_reason(error)}"
            raise LogError(f"{self.path}: {problem}") from None
        if run.format_version != channels.FORMAT_VERSION:
            problem = (
                f"is in format {run.format_version}, but this version of tetractl reads "
                f"format {channels.FORMAT_VERSION}"
            )
            problem += f"; read the log with the version that wrote it, {writer(self.facts)}"
            raise LogError(f"{self.path}: {problem}")
        return run

    def _missing_run_error(self) -> LogError:
        """Create the error for a log that lacks the record which identifies its trial."""
        if self.has_loose_messages:
            return LogError(
                f"{self.path}: another program has rewritten this log without chunks, so its "
                "messages cannot be read",
                "use the log that tetractl wrote, or a copy with chunks",
            )
        if self.problems:
            return LogError(f"{self.path}: the log is damaged, and the record of the run is lost")
        problem = (
            f"this is an MCAP file, but not a log of tetractl in format {channels.FORMAT_VERSION}"
        )
        return LogError(f"{self.path}: {problem}")

    @property
    def result(self) -> Result | None:
        """The result stored in the log.

        The value is None if the result is missing or cannot be read.
        """
        return self.result_or_problem if isinstance(self.result_or_problem, Result) else None

    @property
    def damaged(self) -> bool:
        """Whether the log has lost records, itself or before a recovery, or has no readable result.

        `TrialLog.damage` describes the damage.
        """
        return bool(self.problems) or self.recovered is not None or self.result is None

    @cached_property
    def result_or_problem(self) -> Result | str:
        """The result of the trial, or a message that explains why the result cannot be read."""
        if not self.entries_by_topic[channels.RESULT]:
            return (
                "the log has no result, because the run was cut short or the end of the log is lost"
            )
        try:
            message = next(self.messages(channels.RESULT))
            host_end = next(self.messages(channels.HOST_END), None)
            return stated_result(message, host_end, len(self.run.robots), self.run.unit)
        except (DecodeError, LogError, OverflowError, ValueError) as error:
            return f"the result has values that tetractl never writes: {_reason(error)}"

    @property
    def warnings(self) -> int:
        """Number of warnings and errors among the operator messages, as stored in the log.

        The value is 0 if the log does not contain the number.
        """
        return max(0, self._first_message(channels.RESULT).warnings)

    @cached_property
    def stated_digests(self) -> Digests:
        """The digests stored in the log. They are empty if the log contains none."""
        return self._first_message(channels.DIGESTS)

    @cached_property
    def computed_digests(self) -> Digests:
        """The digests of the records in this file, in tetractl's order."""
        digests = LogDigests()
        for record in self._in_tetractls_order:
            digests.add(record)
        return digests.hexdigests()

    @cached_property
    def _in_tetractls_order(self) -> list[Record]:
        """The records in tetractl's order, in which attachments follow the run and the host.

        Other programs move attachments to another place.
        """
        attachments = [record for record in self.records if isinstance(record, Attachment)]
        leading_count = 0
        while (
            leading_count < len(self.entries)
            and self.entries[leading_count].topic in BEFORE_ATTACHMENTS
        ):
            leading_count += 1
        return [*self.entries[:leading_count], *attachments, *self.entries[leading_count:]]

    @property
    def content_digest(self) -> str:
        """The content digest, computed from the records in the file.

        It ignores host records.
        """
        return self.computed_digests.content

    @property
    def altered(self) -> bool:
        """Whether the content differs from the digest stored in the log.

        False if the log contains no digest, or if another program has only reordered it.
        """
        stated = self.stated_digests.content
        return stated not in ("", self.computed_digests.content) and not self.reordered

    @property
    def host_altered(self) -> bool:
        """Whether the host records differ from the digest stored in the log.

        False if the log contains no digest.
        """
        return self.stated_digests.host not in ("", self.computed_digests.host)

    @property
    def rewritten_by(self) -> str:
        """The program that rewrote a log of tetractl, such as MCAP's own.

        The value is empty if no program rewrote the log.

        Some programs copy tetractl's name together with the header. These are recognised because
        their attachments are in another place.
        """
        if not self.library.startswith(channels.WRITER):
            return self.library or UNKNOWN_PROGRAM
        return "" if self.records == self._in_tetractls_order else UNKNOWN_PROGRAM

    @property
    def reordered(self) -> bool:
        """Whether another program wrote the messages in the order of their times.

        The digests do not apply to that order.
        """
        if not self.rewritten_by:
            return False
        return all(
            entry.log_ns <= next_entry.log_ns for entry, next_entry in pairwise(self.entries)
        )

    @cached_property
    def recovered(self) -> Damage | None:
        """The damage of the original log from which this log was recovered.

        The value is None if this log was not recovered, or if the original log had lost nothing.
        """
        if not self.entries_by_topic[channels.RECOVERED]:
            return None
        record = self._first_message(channels.RECOVERED)
        if record.source and not record.lost:
            return None
        source = f"this log was recovered from {record.source or 'another log'}, which was damaged"
        return Damage(
            problems=tuple(map(printable, (source, *record.problems))),
            lost=tuple(map(printable, record.lost)),
        )

    @cached_property
    def facts(self) -> dict[str, str]:
        """Facts about the computer, the time and the code of the run.

        The value is empty if the facts are lost.
        """
        return decode_facts(self._first_message(channels.HOST).facts)


def _reason(error: Exception) -> str:
    """Return the message of a decoding error in one line."""
    return printable(str(error) or type(error).__name__, 200)


def read_file(path: Path) -> bytes:
    """Read a whole file that should be a log.

    The file is not memory-mapped: if another program shortened a mapped file, reading a missing
    page would kill the process.

    Raises:
        LogError: If the path is not a regular file, or the file is empty, too large or unreadable.
    """
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise LogError(f"{path}: this is a folder, not a log")
        if not path.is_file():  # reading a FIFO may never end
            raise LogError(f"{path}: this is not a regular file")
        if size > file_limit():
            raise limit_error(path, f"{size} bytes")
        data = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:  # a null byte in the name
        raise LogError(f"{path}: {error}") from None
    if not data:
        raise LogError(f"{path}: the file is empty")
    return data


def writer(facts: Mapping[str, str]) -> str:
    """Describe the version of tetractl that wrote a log, for people.

    Args:
        facts: Facts about the computer that wrote the log. `tetractl` is the version, and
            `git_commit` the commit; both may be missing.
    """
    version = printable(facts.get("tetractl", "")[:12]) or "of an unknown version"
    commit = printable(facts.get("git_commit", "")[:12])
    return f"tetractl {version}, git commit {commit}" if commit else f"tetractl {version}"
