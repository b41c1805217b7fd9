"""The values of a batch's statistics: numbers without words. `statistic_text` makes text and JSON.

What a number can be:

    Count          how many trials there are of a kind, or how often something happened
    Share          in how many of n trials a condition holds
    Mean           the mean of one number per trial, with its interval
    Scalar         any other single number, such as a least distance or a percentile
    OutcomeCounts  how many trials ended in each way
    AboveBound     how many trials are in the tail of a distribution
    Worded         a number that comes with its own words
    Unknown        no number, and the reason
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from tetractl.core.plan import Outcome
from tetractl.results.estimate import Distribution, Interval, Tail, proportion_interval


@dataclass(frozen=True, slots=True)
class Count:
    """A number of trials, or of events in them."""

    value: int


@dataclass(frozen=True, slots=True)
class Share:
    """In how many of n trials a condition holds. `counting` is what the condition looks at, such as
    "bodies", if that can differ; otherwise it is "".
    """

    count: int
    n: int
    counting: str = ""

    @property
    def ci95(self) -> Interval:
        """Wilson's interval of the fraction."""
        return proportion_interval(self.count, self.n)


@dataclass(frozen=True, slots=True)
class Mean:
    """The mean of one number per trial; text states the number of trials if `states_n`."""

    distribution: Distribution
    states_n: bool = False


@dataclass(frozen=True, slots=True)
class Scalar:
    """A number, None if it is unknown, and how to show it; `n` is the number of trials that it was
    computed from, if text states it.
    """

    value: float | None
    show: Callable[[float], str]
    n: int | None = None


@dataclass(frozen=True, slots=True)
class OutcomeCounts:
    """How many trials ended in each way."""

    counts: Counter[Outcome]


@dataclass(frozen=True, slots=True)
class AboveBound:
    """How many trials are above the bound of a distribution's tail, which JSON has next to the
    distribution.
    """

    tail: Tail


@dataclass(frozen=True, slots=True)
class Worded:
    """A number, None if it is unknown, and the text of it."""

    value: int | None
    text: str


@dataclass(frozen=True, slots=True)
class Unknown:
    """That there is no number, and the reason, "" if it needs none."""

    reason: str = ""


Number = Count | Share | Mean | Scalar | OutcomeCounts | AboveBound | Worded | Unknown


@dataclass(frozen=True, slots=True)
class StatisticValue:
    """One value of a statistic, over all trials of a batch.

    `key` is its name in JSON, inside the object `within` if that is not "". `label` is its name in
    tables; a value with the label "" is in JSON only. An `unusual` value is one that a reader must
    see, such as damaged logs: the other ones are shown with `--full` only.
    """

    key: str
    label: str
    number: Number
    unusual: bool = True
    within: str = ""
