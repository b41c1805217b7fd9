"""Hostile logs, tables, rows and specs, and what each does to one command that reads it.

A case is made from its number and a seed alone, so that any case can be repeated. Logs have right
checksums and digests, so that what reads them gets far.
"""

import contextlib
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
from support import commands, random_trials, studies
from support.mutate import holder_of, places, rewrite
from support.seeds import files, mutant
from support.targets import ROOT, TARGETS, only, scratch

from tetractl.core.errors import TetractlError
from tetractl.log.format.channels import CHANNELS, Entry
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan
from tetractl.study.options import Logs

SPARSE = 60  # one input in so many is drawn, or given to another slow command
BOMBS = 150  # one table in so many is large


class Case(NamedTuple):
    """One hostile input: the command that reads it, and a function that runs the command."""

    command: str
    run: Callable[[], object]


FLOATS = [math.nan, math.inf, -math.inf, 1e308, -1e308, 1e100, 1e9, -1e9, 5e-324, 0.0, -0.0, 1e-9]
INTEGERS = [0, -1, 1, 255, 2**31 - 1, 2**32 - 1, 2**53, 10**18, 2**63 - 1, -(2**63), 2**64 - 1]
WORDS = [
    "nan", "-inf", "1e308", "-1e308", "5e-324", "0", "-0.0", "-1", "1000", "1e9", "1e5", "0.001",
    "9" * 400, str(2**63), str(2**64 - 1), str(2**127), "true", "null", "[]", "{}", "~", "''",
    "²", "١", "\x00", "\x1b[2J", "\u202e", "=cmd()", '"', "'", "\n", "\r", "\t", "&a [*a]",
    "{a: 1}", "[[[[1]]]]", "[1, 2]", "../x", "x" * 300, "%s", "{0}", "$(x)", "ü", "\ud800", ",",
    "[nan]", '["inf"]', "mpc", "rrt", "pso", "cem", "mppi", "exact", "euler", "arc", "lab", "sim",
    "swept", "circle", "polygon", "free", "replace", "drop", "choose", "hold", "via", "start",
]  # fmt: skip
_TOKEN = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?|[A-Za-z_][\w.]*")


def text_like(text: str, rng: random.Random) -> str:
    """Return a text with some of its numbers, words and lines replaced, repeated or left out."""
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        found = list(_TOKEN.finditer(text)) or [re.match("", text)]
        at: Any = rng.choice(found)
        lines = text.split("\n")
        match rng.randrange(8):
            case 0:
                del lines[rng.randrange(len(lines))]
                text = "\n".join(lines)
            case 1:
                i = rng.randrange(len(lines))
                lines[i:i] = [lines[rng.randrange(len(lines))]] * rng.choice([1, 2, 50])
                text = "\n".join(lines)
            case 2:
                other = rng.choice(found)
                text = text[: at.start()] + other.group() + text[at.end() :]
            case _:
                text = text[: at.start()] + rng.choice(WORDS) + text[at.end() :]
    return text


def bytes_like(data: bytes, rng: random.Random) -> bytes:
    """Return a text with tokens replaced, or with any bytes changed."""
    if rng.randrange(4) == 0:
        return mutant([data], rng)
    return text_like(data.decode("utf-8", "replace"), rng).encode("utf-8", "surrogatepass")


# logs


@cache
def _logs() -> list[RawLog]:
    """Logs of a simulation, of an emulated lab, of made-up trials and of earlier versions."""
    from support.tampering import lab_log, sim_log

    made = [sim_log(_folder("sim")), lab_log(_folder("lab"))]
    one = random_trials.trial(steps=4, frames=3, first=2, iterations=4, length=4)
    made.append(random_trials.write(one, scratch() / "made.mcap"))
    return [scan(path) for path in (*made, *sorted((ROOT / "tests/golden").glob("*.mcap")))]


def _folder(name: str) -> Path:
    folder = scratch() / name
    folder.mkdir(exist_ok=True)
    return folder


def hostile_log(rng: random.Random, path: Path) -> Path:
    """Write a log with some of its records spoilt; one in five has any bytes changed instead."""
    contents = rng.choice(_logs())
    path.unlink(missing_ok=True)
    if rng.randrange(5) == 0:
        path.write_bytes(mutant([contents.path.read_bytes()], rng))
        return path
    records = list(contents.records)
    kinds = {type(record) for record in records}
    for _ in range(rng.choice([1, 1, 2, 4])):
        kind = rng.choice(sorted(kinds, key=str))
        at = rng.choice([i for i, record in enumerate(records) if isinstance(record, kind)])
        records[at : at + 1] = _spoilt(records[at], rng)
        kinds = {type(record) for record in records}
    return rewrite(RawLog(path, records=records, channels=contents.channels), path, {})


def _spoilt(record: Any, rng: random.Random) -> list[Any]:
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
    with contextlib.suppress(DecodeError):  # it may be spoilt already
        message.ParseFromString(entry.data)
    found = list(places(message))
    if not found:
        return entry
    holder, last = holder_of(message, rng.choice(found))
    now = holder[last] if isinstance(last, int) else getattr(holder, last)
    put = rng.choice(FLOATS if isinstance(now, float) else INTEGERS)
    if isinstance(now, str):
        put = rng.choice(WORDS).encode("utf-8", "replace").decode()
    if isinstance(now, bytes):
        put = mutant([now or b"\0"], rng)
    try:
        if isinstance(last, int) and rng.randrange(3) == 0:
            holder.extend([now] * rng.choice([1, 7, 3000]))
        elif isinstance(last, int) and rng.randrange(3) == 0:
            del holder[last:]
        elif isinstance(last, int):
            holder[last] = put
        else:
            setattr(holder, last, put)
    except (OverflowError, TypeError, ValueError):  # a number that the field cannot hold
        return entry
    return entry._replace(data=message.SerializeToString())


def log_case(rng: random.Random) -> Case:
    """A hostile log, and one of the commands that read logs."""
    return _case(hostile_log(rng, scratch() / "hostile.mcap"), commands.LOGS, rng)


def _case(place: Path, names: Sequence[str], rng: random.Random) -> Case:
    slow = [name for name in names if name in commands.SLOW]
    fast = [name for name in names if name not in commands.SLOW]
    name = rng.choice(slow if slow and rng.randrange(SPARSE) == 0 else fast or slow)
    return Case(name, lambda: commands.check(name, place, scratch() / "out"))


# tables, rows, specs


def _poses(rng: random.Random) -> bytes:
    """A table of poses, as `tetractl export` writes it; seldom a large one."""
    if rng.randrange(BOMBS) == 0:
        rows, robots = rng.choice([(20_000, 20_000), (60_000, 3), (3_000, 900), (10, 3)])
        head = "time_s,robot,x_mm,y_mm,heading_rad" + "," * rng.choice([0, 0, 100_000])
        lines = [head, *(f"{i / 9},r{i % robots},{i},0,0" for i in range(rows)), ""]
        return "\n".join(lines).encode()
    return bytes_like(_tables()[0].encode(), rng)


@cache
def _tables() -> tuple[str, str, str]:
    """Poses, commands and a field, as text."""
    times = [k / 20 for k in range(60)]
    poses = [f"{t},r{i},{100 * t},{50 * i},{0.1 * i},True" for t in times for i in range(2)]
    sent = [f"{t},{math.sin(t)},{t - 0.01}" for t in times[::4]]
    field = [f"{t},{math.sin(t)},1" for t in times]
    return (
        "\n".join(["time_s,robot,x_mm,y_mm,heading_rad,valid", *poses, ""]),
        "\n".join(["time_s,direction_rad,observed_s", *sent, ""]),
        "\n".join(["time_s,direction_rad,strength", *field, ""]),
    )


def _identify(rng: random.Random) -> Case:
    folder = _folder("tables")
    (folder / "poses.csv").write_bytes(_poses(rng))
    (folder / "steps.csv").write_bytes(bytes_like(_tables()[1].encode(), rng))
    return _case(folder, ("identify tables",), rng)


def _field(rng: random.Random) -> Case:
    from tetractl_microscope.film.field_file import read_field

    path = scratch() / "field.csv"
    path.write_bytes(bytes_like(_tables()[2].encode(), rng))

    def run() -> None:
        with only(TetractlError, one_line=False):
            read_field(path)

    return Case("field", run)


@cache
def _study() -> Path:
    folder = scratch() / "study"
    studies.run(folder, studies.SMALL, logs=Logs(0, False))
    return folder


def _rows(rng: random.Random) -> Case:
    folder = _study()
    path = folder / "out" / "dead_time=0.1" / "trials.jsonl"
    bomb = rng.choice([b"[" * 5_000_000, b'{"trial": 1, "x": [' + b"[]," * 10**6, b"1\n" * 10**6])
    with path.open("wb") as file:
        file.write(bytes_like(_row_texts().encode(), rng))
        if rng.randrange(BOMBS) == 0:
            for _ in range(rng.choice([1, 30])):
                file.write(bomb + b"\n")
    return _case(folder, commands.STUDIES, rng)


@cache
def _row_texts() -> str:
    return (_study() / "out" / "dead_time=0.1" / "trials.jsonl").read_text()


def _file(place: str, like: str, names: Sequence[str]) -> Callable[[random.Random], Case]:
    """Files at a place, like those in a folder of `experiments`, read by commands."""

    def make(rng: random.Random) -> Case:
        path = scratch() / place
        if not path.parent.exists():
            path.parent.mkdir()
            for base in (ROOT / "experiments").glob("*.yaml"):  # of the studies
                (scratch() / base.name).write_bytes(base.read_bytes())
        path.write_bytes(bytes_like(rng.choice(files(ROOT / "experiments" / like)()), rng))
        return _case(path, names, rng)

    return make


def _target(name: str) -> Callable[[random.Random], Case]:
    """Files like the good ones of a target, read by it."""

    def make(rng: random.Random) -> Case:
        data = bytes_like(rng.choice(TARGETS[name].seeds()), rng)
        return Case(name, lambda: TARGETS[name].run(data))

    return make


IDENTIFIED = ("a", "speed", "heading_bias", "position_noise", "heading_noise", "heading_walk")


def _identified(rng: random.Random) -> Case:
    folder = _folder("identified")
    text = "identified: m.yaml\n" + (ROOT / "experiments/three_m3pi.yaml").read_text()
    robot = "{" + ", ".join(f"{name}: {{value: 6.1}}" for name in IDENTIFIED) + "}"
    found = (
        "identified: 2026-01-01\norigin: lab\nunit: mm\ndead_time: {value: 0.1, low: 0.1}\n"
        f"robots:\n  green: {robot}\n  blue: {robot}\n  red: {robot}\n"
    )
    (folder / "spec.yaml").write_text(text)
    (folder / "m.yaml").write_bytes(bytes_like(found.encode(), rng))
    return _case(folder / "spec.yaml", commands.SPECS[:1], rng)


_SPEC = _file("specs/spec.yaml", ".", commands.SPECS)
_STUDY = _file("studies/study.yaml", "studies", commands.STUDY_FILES)
TABLES = (_identify, _field, _rows, _rows, _SPEC, _SPEC, _STUDY, _target("script"),
          _target("calibration"), _identified)  # fmt: skip


def table_case(rng: random.Random) -> Case:
    """A hostile table, file of rows, spec, study, script or calibration, and what reads it."""
    return rng.choice(TABLES)(rng)


KINDS = {"logs": log_case, "tables": table_case}


def warm_up() -> None:
    """Make what the cases share, and compile what reads it."""
    for name in commands.LOGS:
        commands.call(name, _logs()[0].path, scratch() / "out")
    _study()


def case(kind: str, seed: int, number: int) -> Case:
    """Return case `number` of a kind: `logs`, or `tables`, which are all other files."""
    return KINDS[kind](random.Random(f"{kind}-{seed}-{number}"))
