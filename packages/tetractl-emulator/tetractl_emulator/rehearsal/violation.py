"""A broken sentence of the observer."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Violation:
    """A broken sentence: its name, when [s], and what was found then. `predicted` names the class
    of faults that no camera can show; "" for none.
    """

    name: str
    at_s: float
    finding: str
    predicted: str = ""
