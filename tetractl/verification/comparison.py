"""Compare two records, such as two plans or messages, and find the first difference."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Difference:
    """A value in a log that contradicts the repeated computation or another part of the log.

    Attributes:
        step: The control step. None outside of steps.
        field: The field.
        message: Describes the contradiction.
    """

    step: int | None
    field: str
    message: str

    def in_step(self, step: int | None) -> "Difference":
        """Return a copy of the difference that states this control step, or no step for None."""
        return replace(self, step=step)

    def __str__(self) -> str:
        where = "trial" if self.step is None else f"step {self.step}"
        return f"{where}: {self.field}: {self.message}"


@dataclass(frozen=True, slots=True)
class Unchecked(Difference):
    """A part of a log that was not compared, because that would take too long.

    It is not a contradiction.
    """


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How much two numbers may differ: |ours - logged| <= relative * larger + absolute.

    `larger` is the larger of their magnitudes. With both tolerances 0, the two numbers must have
    the same bits, or both be NaN. Integers, texts and truth values must always be equal.
    """

    relative: float = 0.0
    absolute: float = 0.0

    def differs(self, ours: NDArray[Any], logged: NDArray[Any]) -> NDArray[np.bool_]:
        """Find the elements in which two arrays of the same shape differ, as a mask of this shape.

        NaN equals NaN, and infinity only equals itself. If both tolerances are 0, all bits must be
        equal. Arrays that are not of 64-bit floats must be equal.
        """
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
            near &= np.isfinite(larger)  # infinity is not near a number
        return ~(near | (ours == logged) | both_nan)


SAME_BITS = Tolerance()


def first_difference(
    ours: Any, logged: Any, tolerance: Tolerance = SAME_BITS, name: str = ""
) -> Difference | None:
    """Return the first difference between two records.

    The result is None if they agree.

    A record is a dataclass, a protobuf message, a mapping, a sequence, an array, or a value.

    Args:
        ours: The record that was computed.
        logged: The record from the log.
        tolerance: How far numbers may differ.
        name: Put in front of the field's path, such as "searches.1.history.3".
    """
    return next(_differences(ours, logged, tolerance, name), None)


def _differences(ours: Any, logged: Any, tolerance: Tolerance, name: str) -> Iterator[Difference]:
    """Yield the differences of two records: of their types, then of each part.

    A missing part counts as None, because a log does not distinguish the two.
    """
    if ours is logged:
        return
    if logged is None:
        yield Difference(None, name, "the log has no value here, but one was computed")
        return
    if ours is None:
        yield Difference(None, name, "the log has a value here, but none was computed")
        return
    our_parts = _parts(ours)
    if our_parts is None:
        yield from _value_difference(ours, logged, tolerance, name)
        return
    logged_parts = _parts(logged)
    other_class = is_dataclass(ours) and type(ours) is not type(logged)
    if logged_parts is None or other_class:
        yield Difference(None, name, f"logged {_kind(logged)}, computed {_kind(ours)}")
        return
    if isinstance(ours, Sequence) and len(our_parts) != len(logged_parts):
        yield Difference(
            None, name, f"logged {len(logged_parts)} items, computed {len(our_parts)} items"
        )
    only_logged = [key for key in logged_parts if key not in our_parts]
    for key in (*our_parts, *only_logged):
        part_name = _path(name, key)
        yield from _differences(our_parts.get(key), logged_parts.get(key), tolerance, part_name)


def _parts(record: Any) -> Mapping[Any, Any] | None:
    """Return the parts of a record that count in a comparison, keyed by name or index.

    Fields of a message that are not set are left out. The result is None for a single value or an
    array.
    """
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
    """Return the name of a record's class with its article, such as "a Plan"."""
    name = type(record).__name__
    article = "an" if name[0] in "AEIOUaeiou" else "a"
    return f"{article} {name}"


def _value_difference(
    ours: Any, logged: Any, tolerance: Tolerance, name: str
) -> Iterator[Difference]:
    """Yield the difference of two arrays, numbers, texts or other single values. Nothing if equal.

    The tolerance applies to arrays and floats. All other values must be equal.
    """
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
