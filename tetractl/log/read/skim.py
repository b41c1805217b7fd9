"""Reads an undamaged log in one pass that keeps few of its messages, however long the log is."""

import zlib
from collections.abc import Iterable
from io import BufferedReader, FileIO
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, DataEnd, Footer, Header, McapRecord, Statistics
from mcap.stream_reader import StreamReader

from tetractl.log.format.channels import COMMANDS, LOG, STEP, SUMMARY, Entry
from tetractl.log.format.digest import LogDigests
from tetractl.log.format.tetractl_pb2 import ControllerStep, WheelCommand
from tetractl.log.read import limits
from tetractl.log.read.raw_log import RawLog, Tally
from tetractl.log.read.salvage import MAGIC, unpack


class _Held(BufferedReader):
    """A file that takes memory for what it holds, not for what a record in it claims to hold."""

    def __init__(self, path: Path) -> None:
        super().__init__(FileIO(path))
        self._size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        return super().read(size if size is None else min(size, self._size))


class _Reader(StreamReader):
    """Reads all records but the indexes of chunks' messages, which take longest to read."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        return None if opcode == Opcode.MESSAGE_INDEX else super()._read_record(opcode, length)


def tallied(entries: Iterable[Entry], known: dict[str, Tally] | None = None) -> dict[str, Tally]:
    """Add messages to the tallies of their topics, and return these."""
    found = {} if known is None else known
    for topic, at, _, data in entries:
        count, size, first, last = found.get(topic, (0, 0, at, at))
        found[topic] = (count + 1, size + len(data), min(first, at), max(last, at))
    return found


def skim(path: Path) -> RawLog | None:
    """Return a log with the messages of its run, result and events, the first command with a
    direction, and control steps: the first, and the last with an estimate of each chunk; the others
    are in its tallies and digests.

    None for a damaged file, one without checksums, and one that `scan` does not read.
    """
    try:
        return _skimmed(path)
    except Exception:  # errors of MCAP, zstd, UTF-8 and struct: `scan` says what is wrong
        return None


def _skimmed(path: Path) -> RawLog | None:
    log, digests, topics, counted = RawLog(path, size=path.stat().st_size), LogDigests(), {}, None
    steps: list[Entry] = []
    directed, sealed, begin, stated = False, False, 0, 0
    if log.size > limits.file_limit():
        return None
    with _Held(path) as file:
        reader = _Reader(
            file, emit_chunks=True, validate_crcs=True, record_size_limit=limits.CHUNK_MAX
        )
        for record in reader.records:
            if isinstance(record, Chunk):
                _, channels, messages = unpack(record)
                topics |= {channel.id: channel.topic for channel in channels}
                entries = [
                    Entry(topics[number], at, sampled, data)
                    for number, at, sampled, data in messages
                ]
                digests.messages(entries)
                tallied(entries, log.tallies)
                log.chunks += 1
                log.records += [one for one in entries if one.topic in SUMMARY or one.topic == LOG]
                for one in entries if not directed else ():
                    if one.topic == COMMANDS and not directed:
                        directed = not WheelCommand.FromString(one.data).stop
                        log.records.append(one)
                planned = [one for one in entries if one.topic == STEP]
                steps += planned[: not steps]
                for one in reversed(planned):
                    if ControllerStep.FromString(one.data).HasField("estimate"):
                        steps += [one] if one is not steps[-1] else []
                        break
            elif isinstance(record, Attachment):
                digests.attachment(record.name, record.media_type, record.log_time, record.data)
                log.records.append(record)
            elif isinstance(record, DataEnd):
                sealed = record.data_section_crc != 0
            elif isinstance(record, Statistics):
                counted = record.message_count
            elif isinstance(record, Header):
                log.library = record.library
            elif isinstance(record, Footer):
                begin, stated = record.summary_start, record.summary_crc
        file.seek(begin)
        sealed &= zlib.crc32(file.read()[: -len(MAGIC) - 4]) == stated
    log.records += steps
    log.digests = digests.stated()
    whole = counted == sum(count for count, *_ in log.tallies.values())
    return log if sealed and whole and not log.rewritten else None
