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
        location = "trial" if self.step is None else f"step {self.step}"
        return f"{location}: {self.field}: {self.message}"


@dataclass(frozen=True, slots=True)
class Unchecked(Difference):
    """A part of a log that was not compared, because that would take too long.

    It is not a contradiction.
    """


@dataclass(frozen=True, slots=True)
class Tolerance:
    """A tolerance for numbers: |computed - logged| <= relative * larger + absolute.

    `larger` is the larger of the two magnitudes. If both tolerances are 0, the two numbers must
    have the same bits, or both be NaN. Integers, strings and booleans must always be equal.

    Attributes:
        relative: Relative tolerance.
        absolute: Absolute tolerance, in the unit of the numbers.
    """

    relative: float = 0.0
    absolute: float = 0.0

    def differs(self, computed: NDArray[Any], logged: NDArray[Any]) -> NDArray[np.bool_]:
        """Find the elements in which two arrays of the same shape differ, as a mask of this shape.

        NaN equals NaN, and infinity only equals itself. If both tolerances are 0, all bits must be
        equal. Arrays that are not of 64-bit floats must be equal.
        """
        if computed.dtype != np.float64 or logged.dtype != np.float64:
            return np.asarray(computed != logged)
        both_nan = np.isnan(computed) & np.isnan(logged)
        if not self.relative and not self.absolute:
            computed_bits = np.ascontiguousarray(computed).view(np.uint64)
            logged_bits = np.ascontiguousarray(logged).view(np.uint64)
            return (computed_bits != logged_bits).reshape(computed.shape) & ~both_nan
        with np.errstate(invalid="ignore"):  # inf - inf is NaN
            larger = np.maximum(np.abs(computed), np.abs(logged))
            is_near = np.abs(computed - logged) <= self.relative * larger + self.absolute
            is_near &= np.isfinite(larger)  # infinity is not near a number
        return ~(is_near | (computed == logged) | both_nan)


SAME_BITS = Tolerance()
"""The tolerance of a comparison in which all bits must agree."""


def first_difference(
    computed: Any, logged: Any, tolerance: Tolerance = SAME_BITS, name: str = ""
) -> Difference | None:
    """Find the first difference between a computed record and a logged record.

    A record is a dataclass, a protobuf message, a mapping, a sequence, an array, or a value.

    Args:
        computed: The record that was computed.
        logged: The record from the log.
        tolerance: How far numbers may differ.
        name: Prefix of the path of the field that differs, such as "searches.1".

    Returns:
        The difference. None if the records agree.
    """
    return next(_differences(computed, logged, tolerance, name), None)


def _differences(
    computed: Any, logged: Any, tolerance: Tolerance, name: str
) -> Iterator[Difference]:
    """Yield the differences between two records: first of their types, then of each part.

    A missing part counts as None, because a log does not distinguish the two.
    """
    if computed is logged:
        return
    if logged is None:
        yield Difference(None, name, "the log has no value here, but one was computed")
        return
    if computed is None:
        yield Difference(None, name, "the log has a value here, but none was computed")
        return
    computed_parts = _parts_by_key(computed)
    if computed_parts is None:
        yield from _value_difference(computed, logged, tolerance, name)
        return
    logged_parts = _parts_by_key(logged)
    is_other_class = is_dataclass(computed) and type(computed) is not type(logged)
    if logged_parts is None or is_other_class:
        yield Difference(
            None,
            name,
            f"logged {_class_with_article(logged)}, computed {_class_with_article(computed)}",
        )
        return
    if isinstance(computed, Sequence) and len(computed_parts) != len(logged_parts):
        yield Difference(
            None, name, f"logged {len(logged_parts)} items, computed {len(computed_parts)} items"
        )
    only_logged = [key for key in logged_parts if key not in computed_parts]
    for key in (*computed_parts, *only_logged):
        part_name = _join_path(name, key)
        yield from _differences(
            computed_parts.get(key), logged_parts.get(key), tolerance, part_name
        )


def _parts_by_key(record: Any) -> Mapping[Any, Any] | None:
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


def _class_with_article(record: Any) -> str:
    """Return the name of a record's class with its article, such as "a Plan"."""
    name = type(record).__name__
    article = "an" if name[0] in "AEIOUaeiou" else "a"
    return f"{article} {name}"


def _value_difference(
    computed: Any, logged: Any, tolerance: Tolerance, name: str
) -> Iterator[Difference]:
    """Yield the difference between two single values or arrays, unless they are equal.

    The tolerance applies to arrays and floats. All other values must be equal.
    """
    if isinstance(computed, np.ndarray) != isinstance(logged, np.ndarray):
        message = f"logged {type(logged).__name__}, computed {type(computed).__name__}"
        yield Difference(None, name, message)
    elif isinstance(computed, np.ndarray):
        yield from _array_difference(computed, logged, tolerance, name)
    elif isinstance(computed, float) and isinstance(logged, float | int):
        number = np.array(float(logged))
        yield from _array_difference(np.array(computed), number, tolerance, name)
    elif computed != logged:
        yield Difference(None, name, f"logged {logged!r}, computed {computed!r}")


def _array_difference(
    computed: NDArray[Any], logged: NDArray[Any], tolerance: Tolerance, name: str
) -> Iterator[Difference]:
    if computed.shape != logged.shape:
        yield Difference(None, name, f"logged shape {logged.shape}, computed {computed.shape}")
        return
    is_different = tolerance.differs(computed, logged)
    if is_different.any():
        first_index = tuple(int(i) for i in np.argwhere(is_different)[0])
        path = name
        for index in first_index:
            path = _join_path(path, index)
        message = (
            f"logged {logged[first_index].item()!r}, computed {computed[first_index].item()!r}"
        )
        yield Difference(None, path, message)


def _join_path(name: str, key: object) -> str:
    return f"{name}.{key}" if name else str(key)
