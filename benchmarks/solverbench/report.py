"""How thorough a run is, and the Markdown tables that it prints."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, slots=True)
class Settings:
    """How thorough a run is: the numbers of `seeds` and `trials` to average over."""

    seeds: int
    peer_seeds: int
    trials: int
    cap_s: float  # for one search of one peer
    quick: bool

    @classmethod
    def of(cls, quick: bool) -> "Settings":
        if quick:
            return cls(seeds=1, peer_seeds=1, trials=1, cap_s=0.03, quick=True)
        return cls(seeds=100, peer_seeds=20, trials=20, cap_s=1.0, quick=False)


@dataclass(slots=True)
class Report:
    """The output of one part."""

    title: str
    lines: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        self.lines += [text, ""]

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        rule = ["---"] * len(head)
        self.lines += [*map(_row, (head, rule, *rows)), ""]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def load() -> str:
    """Describe how busy the computer is: the load average over the last minute."""
    return f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def spread(times: Sequence[float] | np.ndarray) -> str:
    """Format p50 / p99 / max of some times [s], in ms."""
    values = np.asarray(times) * 1e3
    p50 = np.median(values)
    p99 = np.quantile(values, 0.99)
    top = values.max()
    return f"{p50:.2f} / {p99:.2f} / {top:.2f}"
