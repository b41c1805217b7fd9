"""Watches the identities of cells: a trial whose cells may have been swapped warns, and aborts if
that lasts."""

from collections.abc import Iterator, Sequence

from tetractl.core.cell_film import CellFilm
from tetractl.core.clock import SECOND
from tetractl.core.commands import Note

SURE = 0.9
"""Least probability of a robot's identity; below it the robot counts as unknown."""


class IdentityWatch:
    """The robots of one run by their `names`; `unknown` are those that have not been known for
    `patience_s` or longer, by their index, and why they must not be steered on."""

    def __init__(self, names: Sequence[str], patience_s: float) -> None:
        self._names, self._patience_ns = names, round(patience_s * SECOND)
        self._since_ns: dict[int, int] = {}  # since when robots are unknown
        self.unknown: dict[int, str] = {}

    def see(self, film: CellFilm) -> Iterator[Note]:
        """Yield what a picture changes, as text; a cell that is not seen changes nothing."""
        now = film.sampled_ns
        for i, (name, probability) in enumerate(zip(self._names, film.sure.tolist(), strict=True)):
            if probability < SURE and i not in self._since_ns:
                self._since_ns[i] = now
                text = f"{name} has met another cell: that this is {name} has the probability"
                yield Note(now, "warning", f"{text} {probability:.2f}")
            elif probability >= SURE and self._since_ns.pop(i, None) is not None:
                yield Note(now, "info", f"{name} is known again, probability {probability:.2f}")
            elif i not in self.unknown and now - self._since_ns.get(i, now) > self._patience_ns:
                seconds = self._patience_ns / SECOND
                self.unknown[i] = f"for {seconds:g} s it has not been known which cell is {name}"

    def forget(self, i: int) -> None:
        """Begin again with another cell in place of a robot."""
        self._since_ns.pop(i, None)
        self.unknown.pop(i, None)
