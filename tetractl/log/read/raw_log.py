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
from tetractl.log.read.limits import file_limit, too_much
from tetractl.log.read.trial_log import Damage
from tetractl.log.read.validate import stated_result

ALTERED = "the content of the log does not match the digest stated in it"
UNKNOWN = "an unknown program"
BEFORE_ATTACHMENTS = (channels.RUN, channels.HOST)
"""Topics of the messages that tetractl writes before the first attachment."""


@dataclass(frozen=True)
class RawLog:
    """The intact records of a log file; `problems` and `lost` are empty for an undamaged file.

    A log ends with two digests that its writer has computed, one of the content and one of the host
    records. If the digests of the records in the file differ from them, the log was altered.
    """

    path: Path
    size: int = 0  # bytes
    records: list[Record] = field(default_factory=list)  # in file order
    chunks: int = 0
    problems: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    channels: dict[str, tuple[Channel, Schema | None]] = field(default_factory=dict)  # by topic
    library: str = ""  # the program that wrote the file
    has_loose_messages: bool = False  # outside chunks

    @cached_property
    def entries(self) -> list[Entry]:
        """All messages of the log, in the order of the file."""
        return [record for record in self.records if isinstance(record, Entry)]

    @cached_property
    def by_topic(self) -> dict[str, list[Entry]]:
        """The messages of each topic of the log, in the order of the file."""
        by_topic: dict[str, list[Entry]] = defaultdict(list)
        for entry in self.entries:
            by_topic[entry.topic].append(entry)
        return by_topic

    @cached_property
    def attachments(self) -> dict[str, Attachment]:
        """The attachments by name. If two have the same name, the first one counts."""
        by_name: dict[str, Attachment] = {}
        for record in self.records:
            if isinstance(record, Attachment):
                by_name.setdefault(record.name, record)
        return by_name

    def text(self, name: str) -> str | None:
        """Return the attachment with this name as text.

        The result is None if the attachment is lost.
        """
        attachment = self.attachments.get(name)
        return None if attachment is None else attachment.data.decode(errors="replace")

    def messages(self, topic: str) -> Iterator[Any]:
        """Decode the messages of a topic one by one, in the order of the file.

        Raises DecodeError at a message that cannot be decoded.
        """
        decode = channels.CHANNELS[topic].FromString
        return (decode(entry.data) for entry in self.by_topic[topic])

    def _stated(self, topic: str) -> Any:
        """Return the first message of a topic. It is empty if the message is lost or unreadable."""
        with suppress(DecodeError, ValueError):
            return next(self.messages(topic), channels.CHANNELS[topic]())
        return channels.CHANNELS[topic]()

    @cached_property
    def run(self) -> Run:
        """The message `/run` of the log, which identifies the trial.

        Raises:
            LogError: If it is lost, unreadable or of another format.
        """
        if not self.by_topic[channels.RUN]:
            raise self._without_run()
        try:
            run = next(self.messages(channels.RUN))
        except (DecodeError, ValueError) as error:
            text = f"the record of the run cannot be read: {_reason(error)}"
            raise LogError(f"{self.path}: {text}") from None
        if run.format_version != channels.FORMAT_VERSION:
            text = (
                f"is in format {run.format_version}, but this version of tetractl reads "
                f"format {channels.FORMAT_VERSION}"
            )
            text += f"; read the log with the version that wrote it, {writer(self.facts)}"
            raise LogError(f"{self.path}: {text}")
        return run

    def _without_run(self) -> LogError:
        """Create the error for a log that lacks the record which identifies its trial."""
        if self.has_loose_messages:
            return LogError(
                f"{self.path}: another program has rewritten this log without chunks, so its "
                "messages cannot be read",
                "use the log that tetractl wrote, or a copy with chunks",
            )
        if self.problems:
            return LogError(f"{self.path}: the log is damaged, and the record of the run is lost")
        text = (
            f"this is an MCAP file, but not a log of tetractl in format {channels.FORMAT_VERSION}"
        )
        return LogError(f"{self.path}: {text}")

    @property
    def result(self) -> Result | None:
        """The result stored in the log.

        The value is None if the result is missing or cannot be read.
        """
        return self.result_or_why_not if isinstance(self.result_or_why_not, Result) else None

    @property
    def damaged(self) -> bool:
        """Whether records were lost, or there is no readable result, or a recovery lost some.

        `TrialLog.damage` describes the damage.
        """
        return bool(self.problems) or self.recovered is not None or self.result is None

    @cached_property
    def result_or_why_not(self) -> Result | str:
        """The result of the trial, or a message about why it cannot be read."""
        if not self.by_topic[channels.RESULT]:
            return (
                "the log has no result, because the run was cut short or the end of the log is lost"
            )
        try:
            message = next(self.messages(channels.RESULT))
            end = next(self.messages(channels.HOST_END), None)
            return stated_result(message, end, len(self.run.robots), self.run.unit)
        except (DecodeError, LogError, OverflowError, ValueError) as error:
            return f"the result has values that tetractl never writes: {_reason(error)}"

    @property
    def warnings(self) -> int:
        """Number of warnings and errors among the operator messages, as stored in the log.

        It is 0 if the log does not contain the number.
        """
        return max(0, self._stated(channels.RESULT).warnings)

    @cached_property
    def stated_digests(self) -> Digests:
        """The digests stored in the log. They are empty if it contains none."""
        return self._stated(channels.DIGESTS)

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
        before = 0
        while before < len(self.entries) and self.entries[before].topic in BEFORE_ATTACHMENTS:
            before += 1
        return [*self.entries[:before], *attachments, *self.entries[before:]]

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
            return self.library or UNKNOWN
        return "" if self.records == self._in_tetractls_order else UNKNOWN

    @property
    def reordered(self) -> bool:
        """Whether another program wrote the messages in the order of their times.

        The digests do not apply to that order.
        """
        if not self.rewritten_by:
            return False
        return all(entry.log_ns <= later.log_ns for entry, later in pairwise(self.entries))

    @cached_property
    def recovered(self) -> Damage | None:
        """The damage of the log from which this one was recovered.

        The value is None if this log was not recovered, or if the original had lost nothing.
        """
        if not self.by_topic[channels.RECOVERED]:
            return None
        record = self._stated(channels.RECOVERED)
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
        return decode_facts(self._stated(channels.HOST).facts)


def _reason(error: Exception) -> str:
    """Return the message of an error in decoding a record, as one line."""
    return printable(str(error) or type(error).__name__, 200)


def read_file(path: Path) -> bytes:
    """Read a whole file that should be a log.

    The file is not memory-mapped: if another program shortened a mapped file, reading a missing
    page would kill the process.

    Raises:
        LogError: If it is no file, is empty or too large, or cannot be read.
    """
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise LogError(f"{path}: this is a folder, not a log")
        if not path.is_file():  # reading a FIFO may never end
            raise LogError(f"{path}: this is not a regular file")
        if size > file_limit():
            raise too_much(path, f"{size} bytes")
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
