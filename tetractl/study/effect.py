"""The error of a study by arm, and by the value of one swept field."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.results.estimate import Distribution, distributions
from tetractl.study.arm import Arm
from tetractl.study.cells import as_yaml
from tetractl.study.load import LoadedStudy
from tetractl.study.store import Store


@dataclass(frozen=True, slots=True)
class FieldValue:
    """The arms in which a field has one value, and the total error of their worlds."""

    value: Any
    arms: int
    error: Distribution


def error_of(loaded: LoadedStudy, store: Store, arms: Sequence[Arm]) -> Distribution:
    """Describe the total error over the worlds that every one of some arms has a result of.

    A world counts once, with its mean over the arms: the same world in two arms is no second
    observation, and counting it as one would make the interval too short.
    """
    errors = [
        {
            trial: error
            for trial, row in store.rows[arm.name].items()
            if trial < loaded.study.trials.count
            and (error := row.error(arm.spec.experiment)) is not None
        }
        for arm in arms
    ]
    worlds = sorted(set.intersection(*(set(found) for found in errors)))
    means = [float(np.mean([found[world] for found in errors])) for world in worlds]
    return distributions(np.array([means], dtype=np.float64))[0]


def field_values(
    loaded: LoadedStudy, store: Store, path: str, arms: Iterable[Arm]
) -> list[FieldValue]:
    """Return the arms that set a field, grouped by its value: numbers rising, others in order."""
    found: dict[str, list[Arm]] = {}
    for arm in arms:
        if path in arm.values:
            found.setdefault(as_yaml(arm.values[path]), []).append(arm)
    made = [
        FieldValue(several[0].values[path], len(several), error_of(loaded, store, several))
        for several in found.values()
    ]
    return sorted(made, key=lambda group: group.value) if numeric(made) else made


def numeric(found: Iterable[FieldValue]) -> bool:
    """Whether a field's values are all numbers."""
    values = [group.value for group in found]
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
