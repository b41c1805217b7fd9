"""Tampers with logs in every channel, record and field, and counts what `verify` notices.

Every checksum and both digests are made to fit, as a person who has tetractl could do.
"""

import random
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcap.records import Attachment

from testkit.mutate import changed, places, rewrite
from tetractl.core.errors import LogError
from tetractl.log.format.channels import (
    BACKGROUND_TOPIC,
    CHANNELS,
    DIGESTS,
    HOST_RECORDS,
    PICTURE_TOPIC,
    RECOVERED,
    RUN,
    SPEC,
    Entry,
)
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import parse_spec
from tetractl.verification.verify import verify

SIM = """
name: tampered
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: one, start: [100, 500], target: [300, 450], a: 6, speed: 200}
  - {name: two, start: [100, 300], target: [300, 350], a: 3, speed: 150}
obstacles: [{type: circle, center: [250, 400], radius: 20}]
wheels: {radius: 40}
controller:
  {type: mpc, period: 0.2, horizon_max: 6, time_limit: 1.2,
   optimizer: {type: pso, particles: 6, iterations: 14}}
plant:
  {type: sim, camera_rate: 30, measurement_noise: {position: 1}, heading_noise: 0.1,
   lost_commands: 0.3}
trials: {count: 3, seed: 7}
"""

Record = Entry | Attachment
Decides = Callable[[Record, str], bool]
"""Returns whether a field of a record decides anything, so that a change of it can be noticed."""


def any_decides(record: Record, what: str) -> bool:
    """Return True: every field does."""
    return True


@dataclass(frozen=True)
class Tampering:
    """A log's records with one thing changed: `channel` is where, `what` the field or deed."""

    channel: str
    what: str
    index: int  # of the record
    records: tuple[Record, ...]  # in the place of that one


def sim_log(folder: Path, sets: Sequence[str] = ()) -> Path:
    """Run one small disturbed simulation; return its log."""
    run_logged(parse_spec(SIM, "tampered.yaml", list(sets)), folder, 1)
    return log_path(folder, 1)


def tamperings(log: RawLog, count: int, decides: Decides = any_decides) -> Iterator[Tampering]:
    """Yield up to `count` changes of each field, fact and attachment, of those that decide."""
    rng = random.Random(1)
    by_kind: dict[tuple[str, str], list[tuple[int, Any]]] = {}
    for index, record in enumerate(log.records):
        for what, how in _deeds(record):
            name = record.topic if isinstance(record, Entry) else record.name
            if decides(record, what):
                by_kind.setdefault((name, what), []).append((index, how))
    for (name, what), deeds in by_kind.items():
        for index, how in rng.sample(deeds, min(count, len(deeds))):
            yield Tampering(name, what, index, _done(log.records[index], what, how))


def _deeds(record: Record) -> Iterator[tuple[str, Any]]:
    if isinstance(record, Entry):
        if record.topic == DIGESTS:  # made to fit
            return
        yield from (("-", None), ("x2", None), ("log time", None), ("publish time", None))
        yield "bytes", None
        message: Any = CHANNELS[record.topic].FromString(record.data)
        for place in places(message):
            words = [part for part in place if isinstance(part, str)]
            if words[0] == "facts":
                words[0] = message.facts[place[1]].key
            yield ".".join(words), place
    else:
        yield from (("-", None), ("text", None))


def _done(record: Record, what: str, how: Any) -> tuple[Record, ...]:
    """Return what stands in the place of a record after a deed: "-" leaves it out."""
    if what in ("-", "x2"):
        return () if what == "-" else (record, record)
    if isinstance(record, Attachment):
        return (replace(record, data=record.data + b"\n# tampered\n"),)
    if what == "log time":
        return (record._replace(log_ns=record.log_ns + 1),)
    if what == "publish time":
        return (record._replace(publish_ns=record.publish_ns - 1),)
    if what == "bytes":  # a field that no schema has
        return (record._replace(data=record.data + b"\xf8\x3e\x01"),)
    message = changed(CHANNELS[record.topic].FromString(record.data), how)
    return (record._replace(data=message.SerializeToString()),)


def noticed(log: RawLog, tampering: Tampering, path: Path) -> bool:
    """Write the tampered log to `path`, return whether `verify` fails on it, and remove it."""
    index = tampering.index
    records = [*log.records[:index], *tampering.records, *log.records[index + 1 :]]
    rewrite(RawLog(log.path, records=records, channels=log.channels), path, {})
    try:
        return not verify(path).ok
    except LogError:
        return True
    finally:
        path.unlink()


def score(
    path: Path,
    count: int,
    kinds: Collection[tuple[str, str]] = (),
    decides: Decides = any_decides,
) -> tuple[Counter[tuple[str, str]], Counter[tuple[str, str]]]:
    """Return how many changes of each (channel, field) were noticed, and how many there were.

    They are those of all fields, or of some `kinds`, without those that decide nothing.
    """
    log = scan(path)
    noticed_of = Counter[tuple[str, str]]()
    tried_of = Counter[tuple[str, str]]()
    with tempfile.TemporaryDirectory() as folder:
        for number, tampering in enumerate(tamperings(log, count, decides)):
            kind = (tampering.channel, tampering.what)
            if kinds and kind not in kinds:
                continue
            tried_of[kind] += 1
            noticed_of[kind] += noticed(log, tampering, Path(folder) / f"{number}.mcap")
    return noticed_of, tried_of


STATED_ONCE = {(RUN, "spec_name"), (SPEC, "text")}
"""What nothing else in a log repeats, apart from the records of the host."""


def missed(path: Path) -> set[tuple[str, str]]:
    """Return of an intact log the (channel, field) of which `verify` misses a change."""
    assert verify(path).problems == ()
    noticed_of, tried_of = score(path, 1)
    apart = {
        PICTURE_TOPIC,
        BACKGROUND_TOPIC,
        DIGESTS,
        RECOVERED,
    }  # without messages here, or sealed
    assert {channel for channel, _ in tried_of} >= CHANNELS.keys() - apart
    unnoticed = {kind for kind in tried_of if noticed_of[kind] < tried_of[kind]}
    return {kind for kind in unnoticed if kind[0] not in HOST_RECORDS} - STATED_ONCE
