"""Pack logs, network captures and texts into one archive for a bug report, without names.

A log in a bundle is a valid log: it can be verified and replayed. Its records are copied, and texts
in them get aliases. Images that a camera added to its log stay as they are.
"""

import json
import tempfile
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from google.protobuf.message import DecodeError, Message
from mcap.records import Attachment

from tetractl.core.errors import LogError, UsageError
from tetractl.log import provenance
from tetractl.log.bundle.aliases import Aliases
from tetractl.log.bundle.capture import alias_capture, is_capture
from tetractl.log.format.channels import (
    BACKGROUND_TOPIC,
    CHANNELS,
    DIGESTS,
    ENVIRONMENT,
    HOST,
    LOG,
    PICTURE_TOPIC,
    RECOVERED,
    RESULT,
    RUN,
    Entry,
    Record,
)
from tetractl.log.read.find import find_logs
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan
from tetractl.log.write.sink import Sink

TEXT_CHANNELS = (RUN, HOST, LOG, RESULT, RECOVERED)
"""Channels whose messages contain text in which names and addresses are replaced."""
COMPUTER_KEY = "host"
"""Key of the computer's name in a log's facts about its host."""
REMOVED = "removed"
"""Text that replaces the computer's name."""
FILE_LIST_KEYS = ("git_changed", "git_untracked")
"""Keys of the lists of file names in a log's environment.

The lists are replaced by their lengths, because file names may contain names of people or projects.
"""
CONTENTS_FILE = "contents.txt"
"""Name of the file in a bundle that lists the contents of the bundle."""
FILE_BYTES_MAX = 500_000_000
"""Maximum size of a file that is not a log [bytes]."""


@dataclass(slots=True)
class Bundle:
    """A summary of an archive of logs and captures that was packed for a bug report.

    Attributes:
        lines: A line for each file, with its name in the bundle and what a reader should know.
        images: Number of images in the logs.
        replaced: Number of different addresses and names that were replaced, by category.
    """

    lines: list[str] = field(default_factory=list)
    images: int = 0
    replaced: dict[str, int] = field(default_factory=dict)


def write_bundle(paths: Sequence[Path], out: Path, names: Iterable[str]) -> Bundle:
    """Write a bundle, one archive of logs, captures and texts for a report on a lab.

    Args:
        paths: Logs, folders of logs, captures of network traffic (pcap), and text files.
        out: The archive to write, a zip file.
        names: Names to replace wherever they occur.

    Returns:
        What the bundle contains.

    Raises:
        UsageError: If a file is of another kind, or `out` exists.
        LogError: If a log cannot be read.
    """
    if out.exists():
        raise UsageError(
            f"{out}: a file of this name exists already", "choose another file with --out"
        )
    logs = [log for path in paths if _has_logs(path) for log in find_logs([path])]
    other_files = [path for path in paths if not _has_logs(path)]
    contents = [scan(log) for log in logs]
    aliases = Aliases(names)
    aliases.add_host_name(provenance.host()[COMPUTER_KEY])
    for log in contents:
        aliases.add_host_name(log.facts.get(COMPUTER_KEY, ""))
    bundle = Bundle()
    part_path = out.with_name(out.name + ".part")
    try:
        with zipfile.ZipFile(part_path, "w", zipfile.ZIP_DEFLATED) as archive:
            for number, log in enumerate(contents):
                _add_log(archive, number, log, aliases, bundle)
            for path in other_files:
                _add_file(archive, path, aliases, bundle)
            archive.writestr(ENVIRONMENT, _alias_environment(provenance.environment(), aliases))
            bundle.lines.append(f"{ENVIRONMENT}: this computer and its packages")
            bundle.replaced = dict(aliases.counts)
            archive.writestr(CONTENTS_FILE, contents_text(bundle))
        part_path.replace(out)
    except FileNotFoundError:
        raise UsageError(f"{out}: the folder {out.parent} does not exist") from None
    except OSError as error:
        raise LogError(f"{out}: cannot be written: {error.strerror}") from error
    finally:
        part_path.unlink(missing_ok=True)
    return bundle


def contents_text(bundle: Bundle) -> str:
    """Describe the contents of a bundle as text: its files, the aliases and the images."""
    counts = [f"{category}: {count}" for category, count in sorted(bundle.replaced.items())]
    replaced = f"replaced by aliases: {', '.join(counts) or 'nothing'}"
    images = [f"{bundle.images} images of the arena are unchanged"] * (bundle.images > 0)
    return "\n".join([*bundle.lines, replaced, *images]) + "\n"


def _has_logs(path: Path) -> bool:
    """Check whether a path can contain logs: a log, a folder or a pattern."""
    return not path.is_file() or path.name.endswith((".mcap", ".mcap.part"))


def _add_log(
    archive: zipfile.ZipFile, number: int, log: RawLog, aliases: Aliases, bundle: Bundle
) -> None:
    """Add a copy of a log to the bundle, in which aliases replace names and addresses.

    `number` is part of the copy's name, because logs of several folders may have the same name.
    """
    if not log.records:
        raise LogError(f"{log.path}: the log is damaged, and nothing in it can be read")
    name = f"logs/{number:03d}-{log.path.name.removesuffix('.part')}"
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / "copy.mcap"
        sink = Sink(copy, ".copying", log.channels)
        last_ns = 0
        for record in log.records:
            if isinstance(record, Entry):
                last_ns = max(last_ns, record.log_ns)
                bundle.images += record.topic in (PICTURE_TOPIC, BACKGROUND_TOPIC)
                if record.topic == DIGESTS:
                    continue
            sink.add(_alias_record(record, aliases))
        if log.entries_by_topic[DIGESTS] and not log.altered and not log.host_altered:
            sink.seal(last_ns)
        sink.close(complete=True)
        archive.write(copy, name)
    damage = f", damaged: {'; '.join(log.problems)}" if log.problems else ""
    bundle.lines.append(f"{name}: {len(log.records)} records{damage}")


def _alias_record(record: Record, aliases: Aliases) -> Record:
    """Return a copy of a record in which aliases replace names and addresses."""
    if isinstance(record, Attachment):
        if record.name == ENVIRONMENT:
            text = _alias_environment(record.data.decode(errors="replace"), aliases)
        elif record.media_type.startswith(("application/yaml", "text/")):
            text = aliases.alias_text(record.data.decode(errors="replace"))
        else:
            return record
        return Attachment(
            record.create_time, record.log_time, record.name, record.media_type, text.encode()
        )
    if record.topic not in TEXT_CHANNELS:
        return record
    try:
        message = CHANNELS[record.topic].FromString(record.data)
    except DecodeError:
        raise LogError(
            f"a record of {record.topic} cannot be read; send the log itself instead"
        ) from None
    _alias_strings(message, aliases)
    return record._replace(data=message.SerializeToString())


def _alias_strings(message: Message, aliases: Aliases) -> None:
    """Replace names and addresses in all fields of a message, including the computer's name."""
    if getattr(message, "key", None) == COMPUTER_KEY:
        message.value = REMOVED  # type: ignore[attr-defined]
    for field_descriptor, value in message.ListFields():
        if field_descriptor.type == field_descriptor.TYPE_MESSAGE:
            for submessage in value if field_descriptor.is_repeated else (value,):
                _alias_strings(submessage, aliases)
        elif field_descriptor.type == field_descriptor.TYPE_STRING and field_descriptor.is_repeated:
            value[:] = [aliases.alias_text(text) for text in value]
        elif field_descriptor.type == field_descriptor.TYPE_STRING:
            setattr(message, field_descriptor.name, aliases.alias_text(value))


def _alias_environment(environment_json: str, aliases: Aliases) -> str:
    """Return a log's environment without the names of the computer and of files.

    Lists of changed files are replaced by their lengths. The result is empty if the text is not a
    JSON object.
    """
    try:
        facts: dict[str, Any] = dict(json.loads(environment_json))
    except (ValueError, TypeError):
        return ""
    if isinstance(facts.get("host"), dict):
        facts["host"][COMPUTER_KEY] = REMOVED
    for key in FILE_LIST_KEYS:
        if key in facts:
            facts[key] = len(facts[key])
    return aliases.alias_text(json.dumps(facts, indent=1)) + "\n"


def _add_file(archive: zipfile.ZipFile, path: Path, aliases: Aliases, bundle: Bundle) -> None:
    """Add a network capture or a text file, in which aliases replace names and addresses.

    Raises:
        UsageError: If the file is neither.
    """
    if path.stat().st_size > FILE_BYTES_MAX:
        raise UsageError(f"{path}: the file is larger than {FILE_BYTES_MAX // 1000000} MB")
    data = path.read_bytes()
    name = f"files/{path.name}"
    if name in archive.namelist():
        raise UsageError(
            f"{path}: another file with the same name is already in the bundle",
            "rename one of the two files",
        )
    if is_capture(data):
        try:
            capture = alias_capture(data, aliases)
        except UsageError as error:
            raise UsageError(f"{path}: {error.message}", error.hint) from None
        archive.writestr(name, capture.data)
        bundle.lines.append(f"{name}: {capture.packets} packets, {capture.left_out} left out")
        return
    try:
        text = data.decode()
        if "\0" in text:
            raise ValueError
    except ValueError:
        raise UsageError(
            f"{path}: the file is neither a log, nor a capture in pcap format, nor a text",
            "attach images and videos to the report yourself, after you have looked at them",
        ) from None
    archive.writestr(name, aliases.alias_text(text))
    bundle.lines.append(f"{name}: text")
