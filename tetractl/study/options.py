"""What may be chosen of a run of a study: which logs are kept, and which share of it is run."""

import re
from dataclasses import dataclass
from typing import Self

from tetractl.core.errors import UsageError


@dataclass(frozen=True, slots=True)
class Logs:
    """Which trials leave their logs: the first `each` of every arm, and those that fail."""

    each: float
    failed: bool

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the rule for `all`, `failed`, `sample:N` or `none`; UsageError for another."""
        if text == "all":
            return cls(float("inf"), True)
        if found := re.fullmatch(r"sample:([1-9]\d{0,6})", text):
            return cls(int(found[1]), False)
        if text in ("failed", "none"):
            return cls(0, text == "failed")
        raise UsageError(f"--logs {text}: must be all, failed, sample:N or none")


@dataclass(frozen=True, slots=True)
class Shard:
    """One of `of` shares of the trials, all of about the same size; `index` counts from 1."""

    index: int = 1
    of: int = 1

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the share for `i/n`; UsageError for another text."""
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise UsageError(f"--shard {text}: must be i/n with i from 1 to n, such as 2/8")
        return cls(int(found[1]), int(found[2]))

    def has(self, number: int) -> bool:
        """Whether the trial of a number, counted over all arms from 0, is in this share."""
        return number % self.of == self.index - 1
