"""Hostile logs, tables, rows and specs, and what each does to one command that reads it.

A case is made from its number and a seed alone, so that any case can be repeated. Logs have right
checksums and digests, so that what reads them gets far.
"""

import math
import random
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from google.protobuf.message import DecodeError
from mcap.records import Attachment
from support import commands, random_trials
from support.mutate import holder_of, places, rewrite
from support.paths import ROOT
from support.tampering import sim_log
from support.targets import files, mutant, scratch

from tetractl.log.format.channels import CHANNELS, Entry
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan

SPARSE = 60  # one input in so many is given to a slow command
BOMBS = 150  # one text in so many is large


class Case(NamedTuple):
    """One hostile input: the command that reads it, and a function that runs the command."""

    command: str
    run: Callable[[], object]


WORDS = [
    "nan", "-inf", "1e308", "-1e308", "5e-324", "0", "-1", "1000", "1e9", "0.001", "9" * 400,
    str(2**63), str(2**127), "true", "null", "[]", "{}", "~", "''", "²", "\x00", "\x1b[2J",
    "\u202e", "=cmd()", '"', "'", "\n", "\r", "\t", "&a [*a]", "{a: 1}", "[[[[1]]]]", "[1, 2]",
    "../x", "x" * 300, "%s", "{0}", "\ud800", ",", "[nan]", "mpc", "exact", "lab", "circle",
]  # fmt: skip
INTEGERS = [0, -1, 1, 255, 2**31 - 1, 2**53, 10**18, 2**63 - 1, -(2**63), 2**64 - 1]
FLOATS = [math.nan, math.inf, -math.inf, 1e308, -1e308, 1e9, 5e-324, 0.0, -0.0, 1e-9]
PUT = {
    float: FLOATS, int: INTEGERS, bool: [True, False], str: WORDS,
    bytes: [b"", b"\0", b"\0" * 24, b"\xff" * 4096],
}  # fmt: skip
TOKEN = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?|[A-Za-z_][\w.]*")


def bytes_like(data: bytes, rng: random.Random) -> bytes:
    """Return a text with some of its numbers, words and lines replaced, repeated or left out, or
    with any bytes changed.
    """
    if rng.randrange(4) == 0:
        return mutant([data], rng)
    lines = data.decode("utf-8", "replace").split("\n")
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        at = rng.randrange(len(lines))
        found = list(TOKEN.finditer(lines[at]))
        match rng.randrange(8):
            case 0 if len(lines) > 1:
                del lines[at]
            case 1:
                times = 10**5 if rng.randrange(BOMBS // 8) == 0 else rng.choice([1, 2, 50])
                lines[at:at] = [lines[at]] * times
            case _ if found:
                old = rng.choice(found)
                put = rng.choice([*WORDS, rng.choice(found).group()])
                lines[at] = lines[at][: old.start()] + put + lines[at][old.end() :]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _case(place: Path, names: Sequence[str], rng: random.Random) -> Case:
    slow = [name for name in names if name in commands.SLOW]
    fast = [name for name in names if name not in commands.SLOW]
    name = rng.choice(slow if slow and rng.randrange(SPARSE) == 0 else fast or slow)
    return Case(name, lambda: commands.check(name, place, scratch() / "out"))


def _folder(name: str) -> Path:
    folder = scratch() / name
    folder.mkdir(exist_ok=True)
    return folder


@cache
def _logs() -> list[RawLog]:
    """Logs of a simulation, of made-up trials, and of earlier versions."""
    one = random_trials.trial(steps=4, frames=3, first=2, iterations=4, length=4)
    made = [sim_log(_folder("sim")), random_trials.write(one, scratch() / "made.mcap")]
    return [scan(path) for path in (*made, *sorted((ROOT / "tests/golden").glob("*.mcap")))]


def log_case(rng: random.Random) -> Case:
    """A log with some of its records spoilt, or with any bytes changed, and what reads it."""
    contents, path = rng.choice(_logs()), scratch() / "hostile.mcap"
    path.unlink(missing_ok=True)
    if rng.randrange(5) == 0:
        path.write_bytes(mutant([contents.path.read_bytes()], rng))
        return _case(path, commands.LOGS, rng)
    records = list(contents.records)
    for _ in range(rng.choice([1, 1, 2, 4])):
        kinds = {getattr(record, "topic", "") for record in records}  # "" is an attachment's
        kind = rng.choice(sorted(kinds))
        same = [i for i, record in enumerate(records) if getattr(record, "topic", "") == kind]
        at = rng.choice(same)
        records[at : at + 1] = _spoilt(records[at], rng)
    rewrite(RawLog(path, records=records, channels=contents.channels), path, {})
    return _case(path, commands.LOGS, rng)


def _spoilt(record: Any, rng: random.Random) -> list[Any]:
    """Return what stands in the place of a record."""
    if rng.randrange(12) == 0:
        return [record] * rng.choice([0, 2, 30])
    if isinstance(record, Attachment):
        return [replace(record, data=bytes_like(record.data, rng))]
    return [_spoilt_entry(record, rng)]


def _spoilt_entry(entry: Entry, rng: random.Random) -> Entry:
    if rng.randrange(8) == 0 or entry.topic not in CHANNELS:
        return entry._replace(data=mutant([entry.data or b"\0"], rng))
    if rng.randrange(8) == 0:
        when = rng.choice([0, 1, entry.log_ns + 1, 2**63 - 1, 2**64 - 1])
        return entry._replace(log_ns=when, publish_ns=rng.choice([when, entry.publish_ns]))
    message = CHANNELS[entry.topic]()
    try:
        message.ParseFromString(entry.data)
        holder, last = holder_of(message, rng.choice(list(places(message))))
        if isinstance(last, int):
            put = rng.choice(PUT[type(holder[last])])
            holder[last:] = rng.choice([[put, *holder[last + 1 :]], [], [holder[last]] * 3000])
        else:
            setattr(holder, last, rng.choice(PUT[type(getattr(holder, last))]))
    except (DecodeError, IndexError, OverflowError, TypeError, ValueError):
        return entry  # it was spoilt already, is empty, or its field cannot hold the number
    return entry._replace(data=message.SerializeToString())


@cache
def _texts() -> list[tuple[Path, dict[Path, list[bytes]], tuple[str, ...]]]:
    """What commands are given, the files of it that are spoilt, with good texts, and who reads."""
    tables, identified, specs = map(_folder, ("tables", "identified", "specs"))
    times, specs_of = [k / 20 for k in range(60)], ROOT / "experiments"
    poses = [f"{t},r{i},{100 * t},{50 * i},{i / 9},True" for t in times for i in range(2)]
    poses = ["time_s,robot,x_mm,y_mm,heading_rad,valid", *poses, ""]
    sent = ["time_s,direction_rad", *(f"{t},{math.sin(t)}" for t in times[::4]), ""]
    names = ("a", "speed", "heading_bias", "position_noise", "heading_noise", "heading_walk")
    robot = "{" + ", ".join(f"{name}: {{value: 6.1}}" for name in names) + "}"
    measured = (
        "identified: 2026-01-01\norigin: lab\nunit: mm\ndead_time: {value: 0.1, low: 0.1}\n"
        f"robots:\n  green: {robot}\n  blue: {robot}\n  red: {robot}\n"
    )
    (identified / "spec.yaml").write_text(
        "identified: m.yaml\n" + (specs_of / "three_m3pi.yaml").read_text()
    )
    for base in specs_of.glob("*.yaml"):  # of the studies
        (scratch() / base.name).write_bytes(base.read_bytes())
    spec, study = specs / "spec.yaml", specs / "study.yaml"
    return [
        (tables, {tables / "poses.csv": ["\n".join(poses).encode()],
                  tables / "steps.csv": ["\n".join(sent).encode()]}, ("identify tables",)),
        (identified / "spec.yaml", {identified / "m.yaml": [measured.encode()]}, ("validate",)),
        (spec, {spec: files(specs_of)()}, commands.SPECS),
        (study, {study: files(specs_of / "studies")()}, commands.STUDY_FILES),
    ]  # fmt: skip


def table_case(rng: random.Random) -> Case:
    """Hostile tables, rows of a study, a spec, study or identified values, and what reads them."""
    place, spoilt, names = rng.choice(_texts())
    for path, good in spoilt.items():
        path.write_bytes(bytes_like(rng.choice(good), rng))
    return _case(place, names, rng)


KINDS = {"logs": log_case, "tables": table_case}


def warm_up(kind: str) -> None:
    """Make what the cases share, and compile what reads it."""
    if kind == "tables":
        _texts()
    else:
        for name in sorted({*commands.LOGS} - commands.SLOW):
            commands.call(name, _logs()[0].path, scratch() / "out")


def case(kind: str, seed: int, number: int) -> Case:
    """Return case `number` of a kind: `logs`, or `tables`, which are all other files."""
    return KINDS[kind](random.Random(f"{kind}-{seed}-{number}"))
