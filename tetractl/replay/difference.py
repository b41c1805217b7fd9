"""Finds the first value in which two records differ: two plans, results or messages."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray


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
