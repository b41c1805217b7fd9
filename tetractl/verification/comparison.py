"""Compares the log of a trial with that of the trial run again, and any two records, such as two
plans or messages, up to the first value that differs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError, Message
from numpy.typing import NDArray

from tetractl.log.format import channels
from tetractl.log.format.channels import CHANNELS, Entry
from tetractl.log.format.tetractl_pb2 import ControllerStep
from tetractl.log.read.raw_log import RawLog


@dataclass(frozen=True, slots=True)
class Difference:
    """A value that contradicts the log: its control step (None outside of steps), its field, and a
    message that describes the contradiction.
    """

    step: int | None
    field: str
    message: str

    def in_step(self, step: int | None) -> "Difference":
        """Return the difference as one of a control step."""
        return replace(self, step=step)

    def __str__(self) -> str:
        where = "trial" if self.step is None else f"step {self.step}"
        return f"{where}: {self.field}: {self.message}"


@dataclass(frozen=True, slots=True)
class Unchecked(Difference):
    """A part of a log that was not compared because that would take too long: no contradiction."""


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
        both_nan = np.isnan(ours) & np.isnan(logged)
        if not self.relative and not self.absolute:
            bits = np.ascontiguousarray(ours).view(np.uint64)
            logged_bits = np.ascontiguousarray(logged).view(np.uint64)
            return (bits != logged_bits).reshape(ours.shape) & ~both_nan
        with np.errstate(invalid="ignore"):  # inf - inf is NaN
            larger = np.maximum(np.abs(ours), np.abs(logged))
            near = np.abs(ours - logged) <= self.relative * larger + self.absolute
        return ~(near | (ours == logged) | both_nan)


SAME_BITS = Tolerance()


def first_difference(
    ours: Any, logged: Any, tolerance: Tolerance = SAME_BITS, name: str = ""
) -> Difference | None:
    """Return the first difference between two records, outside of steps; None if they agree.

    A record is a dataclass, a protobuf message, a mapping, a sequence, an array, or a value. The
    field is a path such as "searches.1.history.3", preceded by `name`.
    """
    return next(_differences(ours, logged, tolerance, name), None)


def _differences(ours: Any, logged: Any, tolerance: Tolerance, name: str) -> Iterator[Difference]:
    """Yield the differences of two records: of their kinds, then of each part, at last of parts
    that only the log has."""
    if ours is logged:
        return
    if ours is None or logged is None:
        said = "logged nothing, computed a value"
        if ours is None:
            said = "logged a value, computed nothing"
        yield Difference(None, name, said)
        return
    our_parts = _parts(ours)
    if our_parts is None:
        yield from _value_difference(ours, logged, tolerance, name)
        return
    if _kind(ours) != _kind(logged):
        yield Difference(None, name, f"logged {_kind(logged)}, computed {_kind(ours)}")
    logged_parts = _parts(logged) or {}
    only_logged = [key for key in logged_parts if key not in our_parts]
    for key in (*our_parts, *only_logged):
        of_log = logged_parts.get(key)
        yield from _differences(our_parts.get(key), of_log, tolerance, _path(name, key))


def _parts(record: Any) -> Mapping[Any, Any] | None:
    """Return the parts of a record that count in a comparison, by their names or numbers; None of a
    single value or an array."""
    if is_dataclass(record):
        compared = [field.name for field in fields(record) if field.compare]
        return {name: getattr(record, name) for name in compared}
    if isinstance(record, Message):
        return {field.name: value for field, value in record.ListFields()}
    if isinstance(record, Mapping):
        return record
    if isinstance(record, Sequence) and not isinstance(record, str | bytes):
        return dict(enumerate(record))
    return None


def _kind(record: Any) -> str:
    """Return the class of a dataclass, the number of items of a sequence, nothing of others."""
    if isinstance(record, Sequence):
        return str(len(record))
    return type(record).__name__ if is_dataclass(record) else ""


def _value_difference(
    ours: Any, logged: Any, tolerance: Tolerance, name: str
) -> Iterator[Difference]:
    """Yield the difference of two arrays, numbers, texts or other single values."""
    if isinstance(ours, np.ndarray) != isinstance(logged, np.ndarray):
        kinds = f"logged {type(logged).__name__}, computed {type(ours).__name__}"
        yield Difference(None, name, kinds)
    elif isinstance(ours, np.ndarray):
        yield from _array_difference(ours, logged, tolerance, name)
    elif isinstance(ours, float) and isinstance(logged, float | int):
        number = np.array(float(logged))
        yield from _array_difference(np.array(ours), number, tolerance, name)
    elif ours != logged:
        yield Difference(None, name, f"logged {logged!r}, computed {ours!r}")


def _array_difference(
    ours: NDArray[Any], logged: NDArray[Any], tolerance: Tolerance, name: str
) -> Iterator[Difference]:
    if ours.shape != logged.shape:
        yield Difference(None, name, f"logged shape {logged.shape}, computed {ours.shape}")
        return
    wrong = tolerance.differs(ours, logged)
    if wrong.any():
        first = tuple(int(i) for i in np.argwhere(wrong)[0])
        path = name
        for index in first:
            path = _path(path, index)
        message = f"logged {logged[first].item()!r}, computed {ours[first].item()!r}"
        yield Difference(None, path, message)


def _path(name: str, part: object) -> str:
    return f"{name}.{part}" if name else str(part)


NOT_COMPARED = {*channels.HOST_RECORDS, channels.DIGESTS, channels.RECOVERED}
"""Records that a trial that is run again has otherwise, or not at all."""


def log_differences(again: RawLog, log: RawLog) -> Iterator[Difference]:
    """Compare the log of a trial with the log of the same trial run again.

    Yields:
        The first difference of each channel and attachment, those of control steps first.
        Attachments that only the log has are not compared: others may add them.
    """
    topics = [topic for topic in CHANNELS if topic not in NOT_COMPARED]
    names = again.attachments.keys() - NOT_COMPARED
    differences: list[Difference] = []
    for topic in topics:
        difference = _topic_difference(again, log, topic)
        if difference is not None:
            differences.append(difference)
    yield from sorted(differences, key=lambda difference: difference.step is None)
    for name in sorted(names):
        logged = log.attachments.get(name)
        if logged is None:
            yield Difference(None, name, "missing")
        elif logged.data != again.attachments[name].data:
            yield Difference(None, name, "differs from the experiment's")


def _topic_difference(again: RawLog, log: RawLog, topic: str) -> Difference | None:
    """Return the first difference between the messages of a topic."""
    pairs = zip_longest(again.by_topic[topic], log.by_topic[topic])
    for number, (ours, logged) in enumerate(pairs):
        if ours != logged:
            return _entry_difference(ours, logged, topic, number)
    return None


def _entry_difference(
    ours: Entry | None, logged: Entry | None, topic: str, number: int
) -> Difference:
    """Return the difference between message `number` of a topic of the trial run again and that of
    the log."""
    name = f"{topic}[{number}]"
    if logged is None:
        return Difference(None, name, "missing")
    if ours is None:
        return Difference(None, name, "is not of the trial")
    times = (ours.log_ns, ours.publish_ns)
    logged_times = (logged.log_ns, logged.publish_ns)
    if logged_times != times:
        return Difference(None, name, f"has the times {logged_times}, not {times}")
    message = CHANNELS[topic]
    try:
        our_message = message.FromString(ours.data)
        logged_message = message.FromString(logged.data)
    except DecodeError:
        return Difference(None, name, "not a valid message of its channel")
    step = our_message.k if isinstance(our_message, ControllerStep) else None
    where = name if step is None else ""
    difference = first_difference(our_message, logged_message, name=where)
    if difference is None:
        difference = Difference(None, name, "has other bytes")
    return difference.in_step(step)
