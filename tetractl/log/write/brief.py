"""The brief log of a trial: run, host, specs and result, and the digest of the whole log, which
running the trial again writes.
"""

from io import BytesIO
from pathlib import Path

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
    Record,
)
from tetractl.log.format.digest import LogDigests
from tetractl.log.format.tetractl_pb2 import Digests
from tetractl.log.write.encoder import Encoder, RecordSink
from tetractl.log.write.mcap_records import FileWriter
from tetractl.tools.files import save_whole

TOPICS = (RUN, HOST, HOST_END, RESULT, DIGESTS)
"""The channels of a brief log."""
LEFT_OUT = frozenset({LAYOUT, ENVIRONMENT})
"""The attachments of a whole log that a brief one lacks."""


class _BriefFile(RecordSink):
    """A sink that hashes all records, and writes those of a brief log to a file in memory."""

    def __init__(self) -> None:
        self._of_whole_log = LogDigests()
        self._stream = BytesIO()
        self._mcap = FileWriter(self._stream)

    def add(self, record: Record) -> None:
        """Hash a record, and write it if a brief log has it."""
        self._of_whole_log.add(record)
        if isinstance(record, Entry):
            is_of_brief_log = record.topic in TOPICS
        else:
            is_of_brief_log = record.name not in LEFT_OUT
        if is_of_brief_log:
            self._mcap.add(record)

    def finished(self, end_ns: int) -> bytes:
        """End the file with the digests at the end of the trial [Unix ns], and return it."""
        of_whole_log = self._of_whole_log.hexdigests()
        of_brief_log = self._mcap.digests.hexdigests()
        stated = Digests(
            content=of_whole_log.content, host=of_brief_log.host, brief=of_brief_log.content
        )
        self._mcap.add(Entry(DIGESTS, end_ns, end_ns, stated.SerializeToString()))
        self._mcap.finish()
        return self._stream.getvalue()


class BriefLog(Encoder):
    """An observer that holds the records of a trial's brief log until they are saved."""

    def __init__(self) -> None:
        self._brief = _BriefFile()
        self._end_ns = 0
        super().__init__(self._brief, hosted=True)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Keep the end of the trial."""
        super().on_stop(stop, result)
        self._end_ns = self._start.start_unix_ns + stop.sent_ns

    def save(self, path: Path) -> None:
        """Write the brief log of a trial that has ended; LogError if that fails. Nothing waits for
        the disk: a trial whose log a power cut damages is run again."""
        save_whole(path, self._brief.finished(self._end_ns))
