"""The brief log of a trial: run, host, specs and result, and the digest of the whole log, which
running the trial again writes.
"""

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path

from mcap.records import Attachment

from tetractl.core.commands import Command
from tetractl.core.trial import Result
from tetractl.log.format.channels import (
    DIGESTS,
    ENVIRONMENT,
    HOST,
    HOST_END,
    LAYOUT,
    RESULT,
    RUN,
    Entry,
)
from tetractl.log.format.digest import LogDigests
from tetractl.log.format.tetractl_pb2 import Digests
from tetractl.log.write.encoder import Encoder
from tetractl.log.write.file_writer import FileWriter
from tetractl.tools.files import save_whole

TOPICS = (RUN, HOST, HOST_END, RESULT, DIGESTS)
"""The channels of a brief log."""
LEFT_OUT = frozenset({LAYOUT, ENVIRONMENT})
"""The attachments of a whole log that a brief one lacks."""


class _KeptRecords:
    """A sink that hashes all records, and keeps those of a brief log."""

    def __init__(self) -> None:
        self._whole = LogDigests()
        self._records: list[Entry | Attachment] = []

    def messages(self, entries: Iterable[Entry]) -> None:
        """Hash messages, and keep those of a brief log."""
        added = list(entries)
        self._whole.messages(added)
        self._records += [entry for entry in added if entry.topic in TOPICS]

    def attachment(self, name: str, media_type: str, unix_ns: int, data: bytes) -> None:
        """Hash an attachment, and keep it if a brief log has it."""
        self._whole.attachment(name, media_type, unix_ns, data)
        if name not in LEFT_OUT:
            self._records.append(Attachment(unix_ns, unix_ns, name, media_type, data))

    def flush(self) -> None:
        """Do nothing: the attachments alone divide a brief log."""

    def file(self, end_ns: int) -> bytes:
        """Return the brief log's file, with the digests at the end of the trial [Unix ns]."""
        stream = BytesIO()
        writer = FileWriter(stream)
        digests = LogDigests()
        for record in self._records:
            if isinstance(record, Entry):
                digests.messages([record])
                writer.add_entry(record)
            else:
                digests.attachment(record.name, record.media_type, record.log_time, record.data)
                writer.flush()
                writer.add_attachment(
                    0, record.log_time, record.name, record.media_type, record.data
                )
        of_whole_log = self._whole.stated()
        of_brief_log = digests.stated()
        stated = Digests(
            content=of_whole_log.content, host=of_brief_log.host, brief=of_brief_log.content
        )
        writer.add_entry(Entry(DIGESTS, end_ns, end_ns, stated.SerializeToString()))
        writer.finish()
        return stream.getvalue()


class BriefLog(Encoder):
    """An observer that holds the records of a trial's brief log until they are saved."""

    def __init__(self) -> None:
        self._kept = _KeptRecords()
        self._end_ns = 0
        super().__init__(self._kept, hosted=True)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Keep the end of the trial."""
        super().on_stop(stop, result)
        self._end_ns = self._trial.start_ns + stop.sent_ns

    def save(self, path: Path) -> None:
        """Write the brief log of a trial that has ended; LogError if that fails. Nothing waits for
        the disk: a trial whose log a power cut damages is run again."""
        save_whole(path, self._kept.file(self._end_ns))
