"""Compares the records of a repeated trial with those in its log, and any two records, such as two
plans or messages, up to the first value that differs.
"""

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError, Message
from numpy.typing import NDArray

from tetractl.core.errors import printable
from tetractl.log.format import channels
from tetractl.log.format.channels import CHANNELS, TEXT, Entry
from tetractl.log.format.codec import DRAWN_PRECISION, decode_frames
from tetractl.log.format.scene import decode_note
from tetractl.log.format.tetractl_pb2 import CameraFrames, ControllerStep
from tetractl.log.read import limits
from tetractl.log.read.raw_log import RawLog


class TooLongError(Exception):
    """Repeating a trial, or comparing its records, would take longer than the limits allow."""


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


NOT_REPEATED = frozenset(
    {
        channels.HOST,
        channels.HOST_END,
        channels.DIGESTS,
        channels.RECOVERED,
        channels.PICTURE,
        channels.BACKGROUND,
    }
)
"""Topics whose messages a repeated trial does not have."""
DRAWN = frozenset({channels.SCENE, channels.SCENE_PLAN, channels.LAYOUT, channels.RESOLVED_SPEC})
"""Records of which other versions may have written other contents."""


class Comparison:
    """A sink of log records that compares each with the log's next of its channel or name.

    With another `tolerance` than `SAME_BITS`, for a log of another machine or version, numbers must
    agree within it, and contents of records in DRAWN are not compared. Once two messages of a
    channel differ, its later ones are not compared. Topics in `without` are not compared.
    """

    def __init__(
        self, raw: RawLog, tolerance: Tolerance = SAME_BITS, without: Iterable[str] = NOT_REPEATED
    ) -> None:
        self._raw, self._tolerance = raw, tolerance
        self._left = {topic: iter(raw.by_topic[topic]) for topic in CHANNELS.keys() - set(without)}
        self._count = Counter[str]()
        self._found: list[Difference] = []
        self.notes = Counter[Entry]()  # the messages for /log
        self._until = time.thread_time() + 2 * limits.seconds_limit()

    def messages(self, entries: Iterable[Entry]) -> None:
        """Compare messages; raises TooLongError."""
        for made in entries:
            if made.topic == channels.LOG:  # in a lab, its order does not follow from the records
                self.notes[made] += 1
            elif made.topic in self._left:  # else a difference was found already
                self._compare(made, next(self._left[made.topic], None))
        if time.thread_time() > self._until:
            raise TooLongError

    def attachment(self, name: str, media_type: str, unix_ns: int, data: bytes) -> None:
        """Compare an attachment."""
        logged = self._raw.attachments.get(name)
        if logged is None:
            self._found.append(Difference(None, name, "missing"))
        elif logged.data != data and (self._tolerance is SAME_BITS or name not in DRAWN):
            self._found.append(Difference(None, name, "differs from the experiment's"))

    def flush(self) -> None:
        """Do nothing: how messages were divided into chunks is not compared."""

    def differences(self) -> Iterator[Difference]:
        """Yield the first difference of each channel and attachment, those of control steps first,
        and what the log has beyond the messages compared. Attachments that only the log has are
        not differences: others may add them.
        """
        yield from sorted(self._found, key=lambda found: found.step is None)
        for topic in self._left.keys() - {channels.LOG}:
            if next(self._left[topic], None) is not None:
                text = f"has more than the {self._count[topic]} messages of the trial"
                yield Difference(None, topic, text)
        logged = Counter(self._raw.by_topic[channels.LOG])
        for entry in (self.notes - logged).elements():
            yield Difference(None, channels.LOG, f"lacks {self._text(entry)}")
            return
        for entry in (logged - self.notes).elements():
            yield Difference(None, channels.LOG, f"the trial does not say {self._text(entry)}")
            return

    def _text(self, entry: Entry) -> str:
        start_ns = self._raw.run.start_unix_ns
        note = decode_note(Log.FromString(entry.data), start_ns)
        return f"{printable(note.text, TEXT)!r} at {entry.log_ns - start_ns} ns"

    def _compare(self, made: Entry, entry: Entry | None) -> None:
        number = self._count[made.topic]
        self._count[made.topic] += 1
        if entry != made and (found := self._difference(made, entry, number)) is not None:
            self._found.append(found)
            del self._left[made.topic]

    def _difference(self, made: Entry, entry: Entry | None, number: int) -> Difference | None:
        step, name = None, f"{made.topic}[{number}]"
        if entry is None:
            return Difference(None, name, "missing")
        if entry[1:3] != made[1:3]:
            return Difference(None, name, f"has the times {entry[1:3]}, not {made[1:3]}")
        exact = self._tolerance is SAME_BITS
        if not exact and made.topic in DRAWN:
            return None
        try:
            ours, logged = (CHANNELS[made.topic].FromString(one.data) for one in (made, entry))
        except DecodeError:
            return Difference(None, name, "not a valid message of its channel")
        if isinstance(ours, ControllerStep):
            step, name = ours.k, ""
        if not exact:
            self._pardon(made.topic, ours, logged)
        tolerance, robots = self._tolerance, len(self._raw.run.robots)
        if isinstance(ours, CameraFrames) and isinstance(logged, CameraFrames):
            ours, logged = (decode_frames(one, robots)._asdict() for one in (ours, logged))
        elif made.topic == channels.TRANSFORMS and not exact:
            tolerance = replace(tolerance, relative=2 * DRAWN_PRECISION)
        found = first_difference(ours, logged, tolerance, name)
        if found is None:
            return Difference(step, name or made.topic, "has other bytes") if exact else None
        return Difference(step, *found)

    def _pardon(self, topic: str, ours: Any, logged: Any) -> None:
        """Make equal what rounding may change: the plant's facts, which are text, and whether a
        robot at an obstacle's edge entered it.
        """
        if topic == channels.RUN:
            del ours.facts[:], logged.facts[:]
        elif topic == channels.RESULT:
            for i, clearance in enumerate(ours.clearance[: len(logged.entered)]):
                if abs(clearance) <= self._tolerance.absolute:
                    ours.entered[i] = logged.entered[i]


def log_difference(again: RawLog, log: RawLog) -> Difference | None:
    """Return the first difference between the logs of a trial and of its repetition, apart from the
    host records; None if they agree.
    """
    left_out = {*channels.HOST_RECORDS, channels.DIGESTS, channels.RECOVERED}
    sink = Comparison(log, without=left_out)
    sink.messages(again.entries)
    for name in again.attachments.keys() - left_out:
        sink.attachment(name, "", 0, again.attachments[name].data)
    return next(sink.differences(), None)
