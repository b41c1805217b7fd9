"""Watches who is who: no trial goes on with cells that may have changed places and says nothing."""

from collections.abc import Iterator, Sequence

from tetractl.core.cell_film import CellFilm
from tetractl.core.clock import SECOND
from tetractl.core.commands import Note

SURE = 0.9
"""Probability that a robot's cell is that cell below which it counts as not known."""


class IdentityWatch:
    """The robots of one run by their `names`; `reason` is why it must end, "" for none.

    That is if a robot is not known for `patience_s` or longer.
    """

    def __init__(self, names: Sequence[str], patience_s: float) -> None:
        self._names, self._patience_ns = names, round(patience_s * SECOND)
        self._since_ns: dict[int, int] = {}  # of robots that are not known
        self.reason = ""

    def see(self, film: CellFilm) -> Iterator[Note]:
        """Yield what a picture changes, for people; a cell that is not seen changes nothing."""
        now = film.sampled_ns
        for i, (name, probability) in enumerate(zip(self._names, film.sure.tolist(), strict=True)):
            if probability < SURE and i not in self._since_ns:
                self._since_ns[i] = now
                text = f"{name} has met another cell: that this is {name} has the probability"
                yield Note(now, "warning", f"{text} {probability:.2f}")
            elif probability >= SURE and self._since_ns.pop(i, None) is not None:
                yield Note(now, "info", f"{name} is known again, probability {probability:.2f}")
            elif not self.reason and now - self._since_ns.get(i, now) > self._patience_ns:
                seconds = self._patience_ns / SECOND
                self.reason = f"for {seconds:g} s it has not been known which cell is {name}"
