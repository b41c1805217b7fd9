"""An arm of a study: one point of the sweep with one controller, and its values as text."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tetractl.experiment.load import LoadedSpec

DIGITS = 6  # of a number in a name or a figure
NAME_LENGTH = 100  # of a folder, far below what file systems take


@dataclass(frozen=True, slots=True)
class Arm:
    """One arm: the spec that its trials are run with, and how it differs from the base.

    `values` are those of the swept fields by path. `hash` is the SHA-256 of the experiment without
    the number of trials, which does not change a trial.
    """

    name: str  # of its folder
    controller: str  # "" if the study names none
    values: Mapping[str, Any]
    sets: tuple[str, ...]  # as `--set` takes them, after the base
    spec: LoadedSpec
    hash: str
    code: str  # names the code here that its trials are run by


def arm_name(controller: str, values: Mapping[str, Any]) -> str:
    """Return a name for an arm that fits a file system: `ours-dead_time=0.07`.

    Fields are called by the last step of their path if no two share it.
    """
    ends = [path.rpartition(".")[2] for path in values]
    paths = ends if len(set(ends)) == len(ends) else list(values)
    words = [controller] * bool(controller)
    words += [f"{path}={shown(value)}" for path, value in zip(paths, values.values(), strict=True)]
    name = re.sub(r"[^A-Za-z0-9._=+-]+", "_", "-".join(words))[:NAME_LENGTH]
    return name.lstrip(".-") or "base"


def shown(value: Any) -> str:
    """Return a value for display: numbers to six digits, of a list of mappings its length."""
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    if isinstance(value, list | tuple) and value and isinstance(value[0], dict):
        return f"{len(value)}"  # such as the robots
    return value if isinstance(value, str) else as_yaml(value)


def as_cell(value: Any) -> Any:
    """Return a value as a cell: numbers, truth values and text as they are, others as YAML."""
    return value if isinstance(value, int | float | str) or value is None else as_yaml(value)


def as_yaml(value: Any) -> str:
    """Return a value in one line as `--set` takes it."""
    return json.dumps(value, ensure_ascii=False)  # JSON is YAML
