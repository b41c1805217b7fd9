"""An MCAP file under construction: bytes in, chunks out, every fault one clear error."""

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import BinaryIO, Concatenate, NoReturn, ParamSpec

from mcap.well_known import MessageEncoding
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from tetractl import __version__
from tetractl.errors import LogError
from tetractl.log.channels import CHANNELS, Entry
from tetractl.log.digest import DIGEST, ContentDigest
from tetractl.log.facts import seal

P = ParamSpec("P")
Method = Callable[Concatenate["Sink", P], None]


def _while_open(method: Method[P]) -> Method[P]:
    """Do nothing on a closed sink; close it and raise LogError where the file system refuses."""

    @wraps(method)
    def guarded(self: "Sink", *args: P.args, **kwargs: P.kwargs) -> None:
        if self._file is None:
            return
        try:
            method(self, *args, **kwargs)
        except OSError as error:
            self._fail(error)

    return guarded


class Sink:
    """Writes NAME.part and renames it to NAME when it is complete.

    Only bytes and strings come in, so that a sink can live in a thread of its own. Where the file
    system refuses, the call raises LogError and the file is closed as it is: what it holds stays
    readable under NAME.part, and later calls do nothing, so that stopping the trial for a full disk
    meets no second error.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._part = path.with_name(path.name + ".part")
        self._digest = ContentDigest()
        self._file: BinaryIO | None = None
        for name in (path, self._part):  # never lose a trial for another of the same name
            if os.path.lexists(name):
                raise LogError(f"{name}: this log exists already", "write to another folder")
        try:
            self._file = self._part.open("xb")
            self._mcap = Writer(self._file, compression=CompressionType.ZSTD, enable_data_crcs=True)
            self._mcap.start(library=f"tetractl {__version__}")
        except OSError as error:
            self._fail(error)
        self._channels = {
            topic: self._mcap.register_channel(
                topic, MessageEncoding.Protobuf, register_schema(self._mcap, message)
            )
            for topic, message in CHANNELS.items()
        }

    @_while_open
    def message(self, entry: Entry) -> None:
        """Add one message."""
        self._digest.message(entry)
        channel = self._channels[entry.topic]
        self._mcap.add_message(channel, entry.log_ns, entry.data, entry.publish_ns)

    @_while_open
    def metadata(self, name: str, facts: Mapping[str, str]) -> None:
        """Add a metadata record, sealed with its checksum, behind all messages so far."""
        self._mcap.flush()
        self._digest.metadata(name, facts)
        self._mcap.add_metadata(name, seal(facts))

    @_while_open
    def last_metadata(self, name: str, facts: Mapping[str, str]) -> None:
        """Add the metadata record that states the content digest of the log, itself included."""
        self._mcap.flush()
        self._digest.metadata(name, facts)
        self._mcap.add_metadata(name, seal({**facts, DIGEST: self._digest.hexdigest()}))

    @_while_open
    def attachment(self, name: str, media_type: str, unix_ns: int, text: str) -> None:
        """Add an attachment behind all messages so far."""
        data = text.encode()
        self._mcap.flush()
        self._digest.attachment(name, media_type, data)
        self._mcap.add_attachment(0, unix_ns, name, media_type, data)

    @_while_open
    def flush(self) -> None:
        """End the chunk and hand everything so far to the operating system."""
        self._mcap.flush()

    @_while_open
    def close(self, complete: bool) -> None:
        """Write the index and close; only a complete log loses its .part."""
        self._mcap.finish()
        self._release()
        if complete:
            self._part.rename(self._path)

    def _fail(self, error: OSError) -> NoReturn:
        with suppress(OSError):  # closing writes what is buffered and meets the same refusal
            self._release()
        why = error.strerror or str(error)
        kept = os.path.lexists(self._part) and self._part.stat().st_size > 0
        raise LogError(
            f"{self._path}: cannot write the log: {why}",
            f"what was written until then is in {self._part}" if kept else None,
        ) from error

    def _release(self) -> None:
        file, self._file = self._file, None
        if file:
            file.close()
