"""Detects when it becomes unknown which cell is which robot.

It also decides which robots therefore count as lost. The spec's rule for lost robots decides what
follows.
"""

from collections.abc import Iterator, Sequence

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats
from tetractl.core.trial import Note

KNOWN_PROBABILITY = 0.9
"""Minimum probability at which a robot's identity counts as known."""


class IdentityWatch:
    """Watches whether it is still known which cell is which robot.

    If the identity of a robot has been unknown for `patience_s` [s], `unknown` maps the robot's
    index to the reason why it counts as lost.
    """

    def __init__(self, names: Sequence[str], patience_s: float) -> None:
        self._names = names
        self._patience_ns = round(patience_s * SECOND)
        self._since_ns: dict[int, int] = {}  # time when each unknown robot became unknown
        self.unknown: dict[int, str] = {}

    def update(self, now_ns: int, probabilities: Floats) -> Iterator[Note]:
        """Yield a note for each robot whose cell becomes known or unknown.

        Args:
            now_ns: Time of the frame [ns].
            probabilities: Probability of each robot's identity, shape (N,). NaN if it is not seen.
        """
        for i, (name, probability) in enumerate(
            zip(self._names, probabilities.tolist(), strict=True)
        ):
            if probability < KNOWN_PROBABILITY and i not in self._since_ns:
                self._since_ns[i] = now_ns
                problem = (
                    f"{name} has met another cell; the probability that the two have not "
                    "been confused is"
                )
                yield Note(now_ns, "warning", f"{problem} {probability:.2f}")
            elif probability >= KNOWN_PROBABILITY and self._since_ns.pop(i, None) is not None:
                yield Note(
                    now_ns,
                    "info",
                    f"{name} is identified again, with probability {probability:.2f}",
                )
            elif (
                i not in self.unknown and now_ns - self._since_ns.get(i, now_ns) > self._patience_ns
            ):
                patience_s = self._patience_ns / SECOND
                self.unknown[i] = f"for {patience_s:g} s it has been uncertain which cell is {name}"

    def forget(self, i: int) -> None:
        """Forget that the identity of robot `i` was unknown: another cell is now this robot."""
        self._since_ns.pop(i, None)
        self.unknown.pop(i, None)
