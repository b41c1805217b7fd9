"""Rollers and helices with unequal step-out in one rotating field: axis and frequency move all.

A robot moves along the direction u of the field's axis [rad], at once, with the speed

    v_i(f) = k_i f  up to its step-out f_i,      k_i (f - sqrt(f^2 - f_i^2))  above it

(Adler's equation, averaged). At the frequencies of the N step-outs, U_ij = v_i(f_j). If U has full
rank, displacements g_i (N, 2) take the legs B = U^-1 g: leg j along B_j at f_j for a time |B_j|.
This is the independent control of Amoudruz and Koumoutsakos (Adv. Intell. Syst. 2022, arXiv
2101.10628), along free directions in place of fixed axes.

For two robots no plan is faster than sum |B_j|. By duality the least time is the greatest value of
sum p_i.g_i over vectors p_i with |v_1(f) p_1 + v_2(f) p_2| <= 1 at all f. This norm is convex in
(v_1, v_2), so only corners of the hull of 0 and the curve (v_1(f), v_2(f)) count, and these are the
two step-outs, f_1 > f_2: between them v_2 is convex in v_1 = k_1 f, below the chord; above f_1 both
speeds fall and v_2/v_1 grows, inside the triangle with 0.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.model.motion.rollers import turned

TOLERANCE = 0.01
"""Robots move alike if their ratio of speeds changes by less than this fraction with frequency."""


class RollerLeg(NamedTuple):
    """A part of a plan: direction [rad] and frequency of the field, and how long they are held."""

    direction: float
    frequency: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Rollers:
    """N rollers: `k` (N,) [length unit] per radian and `step_out` (N,) [rad/s]."""

    names: tuple[str, ...]
    k: Floats
    step_out: Floats

    def speeds(self, frequency: Floats | float) -> Floats:
        """Return the speeds (..., N) [length unit/s] at frequencies (...) [rad/s]."""
        return self.k * turned(np.asarray(frequency, dtype=np.float64)[..., None], self.step_out)

    @property
    def rank(self) -> int:
        """Number of the 2N coordinates that direction and frequency can reach."""
        return 2 * int(np.linalg.matrix_rank(self.speeds(self.step_out) / self.k, rtol=TOLERANCE))

    def require_apart(self) -> None:
        """Raise UsageError, with the robots that move alike, if not all coordinates are reached."""
        if self.rank == 2 * len(self.names):
            return
        f = self.step_out
        i, j = min(combinations(range(len(f)), 2), key=lambda ij: abs(np.log(f[ij[1]] / f[ij[0]])))
        raise UsageError(
            f"reach {self.rank} of {2 * len(f)}: {self.names[i]} and {self.names[j]} move alike at "
            f"every frequency, as their step-outs {f[i]:g} and {f[j]:g} rad/s hardly differ",
            "give them unequal step-outs, by another magnet or another drag",
        )

    def plan(self, displacements: Floats) -> list[RollerLeg]:
        """Return legs that move the robots by (N, 2) [length unit], longest first.

        UsageError if the robots cannot be moved apart.
        """
        self.require_apart()
        legs = np.linalg.solve(self.speeds(self.step_out).T, displacements)
        found = [
            RollerLeg(float(np.arctan2(y, x)), float(f), float(np.hypot(x, y)))
            for (x, y), f in zip(legs, self.step_out, strict=True)
        ]
        return sorted(found, key=lambda leg: -leg.seconds)

    def moved(self, leg: RollerLeg) -> Floats:
        """Return the displacements (N, 2) by a leg [length unit]."""
        along = np.array([np.cos(leg.direction), np.sin(leg.direction)])
        return self.speeds(leg.frequency)[:, None] * leg.seconds * along
