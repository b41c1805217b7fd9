"""Empties a queue to which another thread adds."""

from collections import deque
from typing import TypeVar

T = TypeVar("T")


def drained(waiting: deque[T]) -> list[T]:
    """Remove and return a queue's items, oldest first; another thread may add items meanwhile."""
    found: list[T] = []
    while waiting:
        found.append(waiting.popleft())
    return found
