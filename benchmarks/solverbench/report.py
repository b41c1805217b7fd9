"""Timing by interleaved pairs, and Markdown tables."""

import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, slots=True)
class Settings:
    """How thorough a run is: `seeds` and `trials` to average over, `repeats` of a timing."""

    seeds: int
    peer_seeds: int
    trials: int
    repeats: int
    cap_s: float  # for one search of one peer
    quick: bool

    @classmethod
    def of(cls, quick: bool) -> "Settings":
        if quick:
            return cls(seeds=1, peer_seeds=1, trials=1, repeats=2, cap_s=0.03, quick=True)
        return cls(seeds=100, peer_seeds=20, trials=20, repeats=60, cap_s=1.0, quick=False)


@dataclass(slots=True)
class Report:
    """What one part prints."""

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
    """How busy the machine is: the load average over the last minute."""
    return f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


@dataclass(frozen=True, slots=True)
class Pair:
    """Times of two pieces of work, measured in turn [s], shape (repeats,) each."""

    ours: np.ndarray
    theirs: np.ndarray

    @property
    def ratio(self) -> float:
        """How many times longer theirs takes, both at their least: when nothing interrupts them."""
        return float(self.theirs.min() / self.ours.min())


def in_pairs(ours: Callable[[], object], theirs: Callable[[], object], repeats: int) -> Pair:
    """Time two pieces of work in turn, so that whatever else runs slows both."""
    ours()
    theirs()
    pairs = [(seconds(ours), seconds(theirs)) for _ in range(repeats)]
    times = np.array(pairs)
    return Pair(times[:, 0], times[:, 1])


def spread(times: Sequence[float] | np.ndarray) -> str:
    """p50 / p99 / max of some times [s], in ms."""
    values = np.asarray(times) * 1e3
    p50 = np.median(values)
    p99 = np.quantile(values, 0.99)
    top = values.max()
    return f"{p50:.2f} / {p99:.2f} / {top:.2f}"
