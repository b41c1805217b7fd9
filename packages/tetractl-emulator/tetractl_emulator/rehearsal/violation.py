"""A broken invariant, and the bounds that several share; `docs/rehearsals.md` derives them."""

from dataclasses import dataclass

SLACK_S = 0.02  # a tick, a millisecond of the wire, and what a camera's clock may be off
AIR_S = 0.03  # a tick, the UART and the air


@dataclass(frozen=True, slots=True)
class Violation:
    """A broken invariant: its name, when [s], and what was found. `predicted` names the class of
    faults that the derivation says cannot be distinguished; "" for none.
    """

    name: str
    at_s: float
    found: str
    predicted: str = ""
