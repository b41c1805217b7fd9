"""The records found in a log file, and its metadata decoded once."""

import os
import stat
from collections import defaultdict
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from mcap.records import Attachment, Channel, Metadata, Schema

from tetractl.core.errors import LogError, printable
from tetractl.core.trial import Result
from tetractl.log import provenance
from tetractl.log.format import channels
from tetractl.log.format.channels import FORMAT_VERSION, Entry
from tetractl.log.format.digest import CHECKSUM, DIGEST, HOST_DIGEST, ContentDigest
from tetractl.log.format.metadata import FORMAT, WARNINGS, RunRecord, read_damage, read_run
from tetractl.log.read.limits import FACTOR, Budget, file_limit
from tetractl.log.read.trial_log import Damage
from tetractl.log.read.validate import stated_result

# flags that some systems lack
_NO_WAIT, _BYTES = getattr(os, "O_NONBLOCK", 0), getattr(os, "O_BINARY", 0)
_END = 4096  # number of zeros kept at the end of a file, since the last record may end with zeros


@dataclass
class RawLog:
    """The intact records of a log file; `problems` and `lost` are empty for an undamaged file."""

    path: Path
    size: int = 0  # bytes
    records: list[Entry | Metadata | Attachment] = field(default_factory=list)  # in file order
    chunks: int = 0
    problems: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    channels: dict[str, tuple[Channel, Schema | None]] = field(default_factory=dict)  # by topic
    budget: Budget = field(default_factory=Budget)

    @cached_property
    def entries(self) -> list[Entry]:
        """All messages, in file order."""
        return [record for record in self.records if isinstance(record, Entry)]

    @cached_property
    def by_topic(self) -> dict[str, list[Entry]]:
        """The messages of each topic, in file order."""
        found: dict[str, list[Entry]] = defaultdict(list)
        for entry in self.entries:
            found[entry.topic].append(entry)
        return found

    @cached_property
    def attachments(self) -> dict[str, Attachment]:
        """The attachments by name; of two with the same name, the first."""
        found: dict[str, Attachment] = {}
        for record in self.records:
            if isinstance(record, Attachment):
                found.setdefault(record.name, record)
        return found

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The items of each metadata record by its name, as written; of two with the same name, the
        first.
        """
        found: dict[str, dict[str, str]] = {}
        for record in self.records:
            if isinstance(record, Metadata):
                found.setdefault(record.name, record.metadata)
        return found

    @cached_property
    def run(self) -> RunRecord:
        """The run record; LogError if it is lost, unreadable or of a newer log format."""
        items = self.metadata.get(channels.RUN)
        if items is None:
            if self.problems:
                raise LogError(f"{self.path}: damaged: the record of the run is lost")
            raise LogError(f"{self.path}: an MCAP file, but not a log of tetractl")
        try:
            version = int(items[FORMAT])
            if version == FORMAT_VERSION:
                return read_run(items)
        except (KeyError, RecursionError, TypeError, ValueError) as error:
            raise LogError(
                f"{self.path}: the record of the run cannot be read: {_reason(error)}"
            ) from None
        raise LogError(
            f"{self.path}: has log format {version}; this tetractl reads format {FORMAT_VERSION}",
            "use the tetractl that wrote the log",
        )

    @property
    def result(self) -> Result | None:
        """The result stated in the log, None if it cannot be read."""
        return self.result_read[0]

    @cached_property
    def result_read(self) -> tuple[Result | None, str]:
        """The result and "", or None and the reason why it cannot be read."""
        items = self.metadata.get(channels.RESULT)
        if items is None:
            return None, "the log has no result: the run was cut short or the log's end is lost"
        try:
            timing, run = self.metadata.get(channels.TIMING), self.run
            return stated_result(items, timing, len(run.robots), run.items["unit"]), ""
        except (KeyError, LogError, OverflowError, RecursionError, TypeError, ValueError) as error:
            return None, f"the result has values that tetractl does not write: {_reason(error)}"

    @property
    def warnings(self) -> int:
        """The number of operator warnings and errors stated in the log; 0 if not stated."""
        stated = self.metadata.get(channels.RESULT, {}).get(WARNINGS, "")
        return int(stated) if stated.isdecimal() and len(stated) < 12 else 0

    @property
    def stated_digest(self) -> str | None:
        """The content digest that the result record states."""
        return self.metadata.get(channels.RESULT, {}).get(DIGEST)

    @cached_property
    def recovered(self) -> Damage | None:
        """The damage of the log from which this one was recovered, None if it was not recovered."""
        items = self.metadata.get(channels.RECOVERED)
        if items is None:
            return None
        try:
            found = read_damage(items)
        except (KeyError, RecursionError, TypeError, ValueError):
            return Damage(("recovered from a damaged log",), ())
        if found is None:
            return None
        return Damage(*(tuple(map(printable, told)) for told in (found.problems, found.lost)))

    @cached_property
    def host(self) -> dict[str, str]:
        """Machine and time of the run."""
        return self._host(versions=False)

    @cached_property
    def versions(self) -> dict[str, str]:
        """Versions of the code that ran the trial."""
        return self._host(versions=True)

    def _host(self, versions: bool) -> dict[str, str]:
        items = self.metadata.get(channels.HOST, {}).items()
        chosen = {key: value for key, value in items if provenance.is_version(key) == versions}
        return {key: value for key, value in chosen.items() if key != CHECKSUM}

    def text(self, name: str) -> str | None:
        """Return the attachment `name` as text, None if it is lost."""
        found = self.attachments.get(name)
        return None if found is None else found.data.decode(errors="replace")

    @cached_property
    def digest(self) -> str:
        """The content digest, computed from the records."""
        return self._digest(ContentDigest())

    @property
    def host_altered(self) -> bool:
        """Whether the host records do not match their digest, which the last of them states.

        False for logs of earlier versions, which lack this digest.
        """
        stated = self.metadata.get(channels.TIMING, {}).get(HOST_DIGEST)
        return stated is not None and stated != self._digest(ContentDigest(host=True))

    def _digest(self, digest: ContentDigest) -> str:
        for record in self.records:
            if isinstance(record, Entry):
                digest.message(record)
            elif isinstance(record, Metadata):
                digest.metadata(record.name, record.metadata)
            else:
                digest.attachment(record.name, record.media_type, record.data)
        return digest.hexdigest()


def _reason(error: Exception) -> str:
    """Return the message of an error in decoding a record, in one line."""
    text = f"{error} is missing" if isinstance(error, KeyError) else str(error)
    return printable(text or type(error).__name__, 200)


def read_file(path: Path) -> tuple[bytes, int, str | None]:
    """Return a file's bytes, its size, and a problem if not all bytes were read.

    The file is not memory-mapped: if another program shortened a mapped file, reading a missing
    page would kill the process. Zeros at the end, left by a power cut, are returned only in part.
    Raises LogError if the path is not a file, or the file is empty or cannot be read.
    """
    try:
        # O_NONBLOCK, since opening a pipe that no process writes to would wait for ever
        handle = os.open(path, os.O_RDONLY | _NO_WAIT | _BYTES)
        with os.fdopen(handle, "rb") as file:
            found, limit = os.fstat(handle), file_limit()
            if not stat.S_ISREG(found.st_mode):
                raise LogError(f"{path}: is not a file")
            data = file.read(min(limit, found.st_size))
            size = found.st_size
    except IsADirectoryError:
        raise LogError(f"{path}: is a folder, not a log") from None
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if not data:
        raise LogError(f"{path}: the file is empty")
    problem = None
    if size > len(data) == limit:
        problem = f"only the first {limit} of {size} bytes are read; {FACTOR}=2 reads twice that"
    used = len(data.rstrip(b"\0")) + _END
    return data[:used] if used < len(data) else data, size, problem
