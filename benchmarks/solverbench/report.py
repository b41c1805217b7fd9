"""How thorough a run is, and the Markdown tables that it prints."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, slots=True)
class Settings:
    """How thorough a run is.

    Attributes:
        seeds: Number of seeds for our solver and for the printed problem.
        peer_seeds: Number of seeds for other solvers on the recommended problem.
        trials: Number of trials of the closed loop.
        cap_s: Time limit of one search [s].
        quick: Whether the run only shows that everything works.
    """

    seeds: int
    peer_seeds: int
    trials: int
    cap_s: float
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
        self.lines += [*map(_format_row, (head, rule, *rows)), ""]


def _format_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def describe_load() -> str:
    """Describe how busy the computer is: the load average over the last minute."""
    return f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"


def print_progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def format_spread(times_s: Sequence[float] | np.ndarray) -> str:
    """Format the median, the 99th percentile and the maximum of times in ms: "P50 / P99 / MAX".

    Args:
        times_s: The times [s].
    """
    times_ms = np.asarray(times_s) * 1e3
    p50 = np.median(times_ms)
    p99 = np.quantile(times_ms, 0.99)
    longest = times_ms.max()
    return f"{p50:.2f} / {p99:.2f} / {longest:.2f}"
