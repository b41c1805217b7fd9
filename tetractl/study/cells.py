"""Values of swept fields as text and as cells of a table."""

import json
from typing import Any

DIGITS = 6


def shown(value: Any) -> str:
    """Return a value as people read it: numbers to six digits, of a list of mappings its length."""
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
