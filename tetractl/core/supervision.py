"""What people have to do with a run in the lab."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol


class PlacementPrompt(Protocol):
    """A person who puts robots on their starts."""

    def place(self, lines: Sequence[str], questions: Sequence[str] = ()) -> None:
        """Show what keeps the robots from starting, one line each; none: all is ready.

        Who lets the robots start answers yes to the `questions`, a line each. Called again and
        again while robots are placed.
        """
        ...

    def go(self) -> bool:
        """Return whether the person lets the robots start."""
        ...


@dataclass(slots=True)
class LabSupervision:
    """The people at a run in the lab.

    `emergency` set is the emergency stop. `prompt` None: no person is asked, and robots that are
    not on their starts within the spec's `placing` time end the run. `cancelled` returns whether a
    person wants to wait no longer.
    """

    emergency: threading.Event = field(default_factory=threading.Event)
    prompt: PlacementPrompt | None = None
    cancelled: Callable[[], bool] = lambda: False
