"""A document's data as strict validation wants it."""

from typing import Any


def frozen(value: Any) -> Any:
    """Return a document's data with tuples for lists, which is what strict validation wants."""
    if isinstance(value, dict):
        return {key: frozen(item) for key, item in value.items()}
    return tuple(map(frozen, value)) if isinstance(value, list) else value
