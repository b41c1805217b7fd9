"""Results as JSON, and as the flat rows of a data table."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np


def json_text(value: Any, indent: int | None = 2) -> str:
    """Return JSON of plain data, dataclasses and arrays; a number that is not finite becomes
    null.
    """
    return json.dumps(plain(value), indent=indent, ensure_ascii=indent is not None, allow_nan=False)


def plain(value: Any) -> Any:
    """Convert data to dictionaries, lists, texts and finite numbers; other numbers become None."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def flat(items: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested items as one level: a `ci95` pair becomes `low` and `high`, lists become
    text.
    """
    found: dict[str, Any] = {}
    for key, value in items.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            found |= flat(value, f"{name}_")
        elif key == "ci95":
            low, high = value or (None, None)
            found |= {f"{prefix}low": low, f"{prefix}high": high}
        else:
            found[name] = "; ".join(map(str, value)) if isinstance(value, list | tuple) else value
    return found
