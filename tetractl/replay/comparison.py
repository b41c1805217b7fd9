"""Compares the log of a trial with that of the trial run again, and any two records, such as two
plans or messages, up to the first value that differs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError, Message
from numpy.typing import NDArray

from tetractl.log.format import channels
from tetractl.log.format.channels import CHANNELS, Entry
from tetractl.log.format.tetractl_pb2 import ControllerStep
from tetractl.log.read.raw_log import RawLog


class TooLongError(Exception):
    """Computing the decisions of a trial would take longer than the limits allow."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A value that contradicts the log: its control step (None outside of steps), its field, and a
    message that describes the contradiction.
    """

    step: int | None
    field: str
    message: str

    def __str__(self) -> str:
        where = "trial" if self.step is None else f"step {self.step}"
        return f"{where}: {self.field}: {self.message}"


@dataclass(frozen=True, slots=True)
class Tolerance:
    """The allowed difference between two numbers: |ours - logged| <= relative * larger + absolute.

    `larger` is the larger of their magnitudes. With both tolerances 0, the two numbers must have
    the same bits, or both be NaN. Integers, texts and truth values must always be equal.
    """

    relative: float = 0.0
    absolute: float = 0.0

    def differs(self, ours: NDArray[Any], logged: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which elements of two arrays of the same shape differ."""
        if ours.dtype != np.float64 or logged.dtype != np.float64:
            return np.asarray(ours != logged)
        with np.errstate(invalid="ignore"):  # inf - inf is NaN
            if self.relative or self.absolute:
                larger = np.maximum(np.abs(ours), np.abs(logged))
                near = np.abs(ours - logged) <= self.relative * larger + self.absolute
                return ~(near | (ours == logged) | (np.isnan(ours) & np.isnan(logged)))
        bits = [np.ascontiguousarray(one).view(np.uint64) for one in (ours, logged)]
        return (bits[0] != bits[1]).reshape(ours.shape) & ~(np.isnan(ours) & np.isnan(logged))


SAME_BITS = Tolerance()


def first_difference(
    ours: Any, logged: Any, tolerance: Tolerance = SAME_BITS, name: str = ""
) -> tuple[str, str] | None:
    """Return the field and a description of the first difference between two records, None if they
    agree.

    A record is a dataclass, a protobuf message, a mapping, a sequence, an array, or a value. The
    field is a path such as "searches.1.history.3", preceded by `name`.
    """
    return next(_differences(ours, logged, tolerance, name), None)


def _differences(
    ours: Any, logged: Any, tolerance: Tolerance, name: str
) -> Iterator[tuple[str, str]]:
    if ours is logged:
        return
    if ours is None or logged is None:
        stated, found = ("nothing" if one is None else "a value" for one in (logged, ours))
        yield name, f"logged {stated}, computed {found}"
    elif isinstance(ours, np.ndarray):
        yield from _array_difference(ours, logged, tolerance, name)
    elif isinstance(ours, float):
        if tolerance.differs(np.array(ours), np.array(float(logged))).any():
            yield name, f"logged {logged!r}, computed {ours!r}"
    elif isinstance(ours, str | bytes | int | np.generic):
        if ours != logged:
            yield name, f"logged {logged!r}, computed {ours!r}"
    elif isinstance(ours, Sequence):
        if len(ours) != len(logged):
            yield name, f"logged {len(logged)}, computed {len(ours)}"
        for i, (one, two) in enumerate(zip(ours, logged, strict=False)):
            yield from _differences(one, two, tolerance, _path(name, i))
    elif is_dataclass(ours) and type(ours) is not type(logged):
        yield name, f"logged {type(logged).__name__}, computed {type(ours).__name__}"
    else:
        one, two = _items(ours), _items(logged)
        for key in (*one, *(two.keys() - one.keys())):
            yield from _differences(one.get(key), two.get(key), tolerance, _path(name, key))


def _items(record: Any) -> Mapping[str, Any]:
    """Return the parts of a record by name."""
    if is_dataclass(record):
        return {field.name: getattr(record, field.name) for field in fields(record)}
    if isinstance(record, Message):
        return {field.name: value for field, value in record.ListFields()}
    return record


def _array_difference(
    ours: NDArray[Any], logged: NDArray[Any], tolerance: Tolerance, name: str
) -> Iterator[tuple[str, str]]:
    if ours.shape != logged.shape:
        yield name, f"logged shape {logged.shape}, computed {ours.shape}"
        return
    wrong = tolerance.differs(ours, logged)
    if wrong.any():
        at = tuple(int(i) for i in np.argwhere(wrong)[0])
        text = f"logged {logged[at].item()!r}, computed {ours[at].item()!r}"
        yield ".".join(map(str, (name, *at))) if name else ".".join(map(str, at)), text


def _path(name: str, part: object) -> str:
    return f"{name}.{part}" if name else str(part)


NOT_COMPARED = {*channels.HOST_RECORDS, channels.DIGESTS, channels.RECOVERED}
"""Records that a trial that is run again has otherwise, or not at all."""


def log_differences(again: RawLog, log: RawLog) -> Iterator[Difference]:
    """Yield the first difference of each channel and attachment between the log of a trial and that
    of the trial run again, those of control steps first; of a brief log only what it has.

    Attachments that only the log has are not differences: others may add them.
    """
    topics = [topic for topic in CHANNELS if topic not in NOT_COMPARED]
    names = again.attachments.keys() - NOT_COMPARED
    if log.brief:
        topics = [topic for topic in topics if log.by_topic[topic]]
        names &= log.attachments.keys()
    found = [_topic_difference(again, log, topic) for topic in topics]
    yield from sorted(filter(None, found), key=lambda one: one.step is None)
    for name in sorted(names):
        logged = log.attachments.get(name)
        if logged is None:
            yield Difference(None, name, "missing")
        elif logged.data != again.attachments[name].data:
            yield Difference(None, name, "differs from the experiment's")
    if log.brief and again.content_digest != log.content_digest:
        yield Difference(None, "content_digest", "is not that of the trial run again")


def _topic_difference(again: RawLog, log: RawLog, topic: str) -> Difference | None:
    """Return the first difference between the messages of a topic."""
    pairs = zip_longest(again.by_topic[topic], log.by_topic[topic])
    for number, (made, entry) in enumerate(pairs):
        if made != entry:
            return _entry_difference(made, entry, topic, number)
    return None


def _entry_difference(
    made: Entry | None, entry: Entry | None, topic: str, number: int
) -> Difference:
    """Return the difference between message `number` of a topic of the trial run again and that of
    the log."""
    name = f"{topic}[{number}]"
    if made is None or entry is None:
        return Difference(None, name, "missing" if entry is None else "is not of the trial")
    if entry[1:3] != made[1:3]:
        return Difference(None, name, f"has the times {entry[1:3]}, not {made[1:3]}")
    try:
        ours, logged = (CHANNELS[topic].FromString(one.data) for one in (made, entry))
    except DecodeError:
        return Difference(None, name, "not a valid message of its channel")
    step = ours.k if isinstance(ours, ControllerStep) else None
    field, text = first_difference(ours, logged, name="" if step is not None else name) or (
        name,
        "has other bytes",
    )
    return Difference(step, field, text)
