"""The likelihood of differences of noisy measurements along a chain of intervals.

A quantity is measured at the ends of K intervals, each time with an error e of standard deviation
s. Between measurements it also walks at random, with standard deviation w after one second. The
residual of interval k, which lasts t_k, is then

    r_k = e_(k+1) - F_k e_k + w sqrt(T_k) n_k,      T_k = t_k (1 + 4 F_k + F_k^2) / 6,

where n_k is standard normal, and F_k is the derivative of the model's value at the interval's end
with respect to the value at its start: a deviation at the interval's start is multiplied by F_k
until its end, a deviation that arises later by a power of F_k between 0 and 1 (T_k is Simpson's
rule for t_k times the integral of F_k^(2 x), x from 0 to 1). The covariance A of r is tridiagonal:
s^2 (1 + F_k^2) + w^2 T_k on the diagonal, -s^2 G_k next to it if interval k begins with the frame
that interval k - 1 ended with. G_k is F_k; for displacements projected along a path it is the
cosine of the angle between both intervals' paths. With A = L L^T, the elements of y = L^-1 r are
independent with standard deviation 1, and

    -2 ln likelihood = sum y^2 + 2 sum ln L_kk + a constant.

Fitting P parameters makes the residuals smaller than the errors. With the derivatives X (K, P) of
the model with respect to the parameters, the restricted likelihood accounts for this: its y are the
residuals of y after least squares on L^-1 X, and ln det X^T A^-1 X is added.

Source: Patterson and Thompson, "Recovery of inter-block information when block sizes are unequal",
Biometrika 58 (1971).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs
from scipy.optimize import minimize, minimize_scalar, root_scalar

from tetractl.core.poses import Bools, Floats

LIMIT = 3.841
"""95 % quantile of chi-squared with one degree of freedom."""
# factorise and solve band matrices
_CHOLESKY, _SOLVE = get_lapack_funcs(("pbtrf", "tbtrs"), dtype=np.float64)
TINY = 1e-12  # relative to the trace; keeps X^T A^-1 X regular for parameters without effect
LEAST = 1e-7  # least deviation, relative to that of the residuals


@dataclass(frozen=True, slots=True)
class SampleInterval:
    """A value and its 95 % interval; an end is infinite if the data do not bound the value."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class ChainNoise:
    """Standard deviations: `measured`, of one measurement; `walk`, of the random walk after one
    second, per square root of time [1/sqrt(s)].
    """

    measured: float
    walk: float


@dataclass(frozen=True, slots=True)
class Chain:
    """The K intervals of one robot: `t` (K,) [s] is the length of each, `slope` (K,) the derivative
    F of the value predicted for the interval's end with respect to the value at its start, and
    `used` (K,) is whether the interval is used.

    `linked` (K,) is True for intervals that begin with the last frame of the interval before.
    `coupling` (K,) is G in the covariance of the residuals of two such intervals, by default F.
    """

    t: Floats
    slope: Floats
    used: Bools
    linked: Bools
    coupling: Floats | None = None

    def variance(self, noise: ChainNoise) -> Floats:
        """Return the variance of each residual (K,), the diagonal of A."""
        walked = self.t * np.maximum(1 + 4 * self.slope + self.slope**2, 0.0) / 6
        return noise.measured**2 * (1 + self.slope**2) + noise.walk**2 * walked + 1e-300

    def factor(self, noise: ChainNoise) -> Floats:
        """Return the diagonal and subdiagonal of L, the Cholesky factor of the residuals'
        covariance A, as rows (2, K). An unused interval has 1 on the diagonal and 0 below it.
        """
        both = self.linked & self.used & np.append(False, self.used[:-1])
        banded = np.zeros((2, self.t.size))
        s2 = noise.measured**2
        banded[0] = np.where(self.used, self.variance(noise), 1.0)
        coupling = self.slope if self.coupling is None else self.coupling
        banded[1, :-1] = np.where(both, -s2 * coupling, 0.0)[1:]
        found, info = _CHOLESKY(banded, lower=1)
        assert info == 0, "a covariance is positive definite"
        return found

    def whiten(self, factor: Floats, columns: Floats) -> Floats:
        """Return L^-1 times columns (K, M), with 0 for unused intervals; `factor` is L as the
        method `factor` returns it.
        """
        columns = np.where(self.used[:, None], columns, 0.0)
        found, info = _SOLVE(factor, columns, uplo="L")
        assert info == 0, "the diagonal of L is positive"
        return found

    def deviance(self, noise: ChainNoise, r: Floats, by: Floats) -> float:
        """Return -2 ln of the restricted likelihood of residuals (K,); `by` (K, P) is X, the
        derivatives of the model with respect to the parameters.
        """
        factor = self.factor(noise)
        whitened = self.whiten(factor, np.column_stack([r, by]))
        y, x = whitened[:, 0], whitened[:, 1:]
        total = y @ y + 2 * np.log(factor[0]).sum()
        normal, right = x.T @ x, x.T @ y
        if not normal.size:
            return float(total)
        normal.flat[:: len(normal) + 1] += TINY * max(np.trace(normal), TINY)  # it may be 0
        explained = right @ np.linalg.solve(normal, right)
        return float(total - explained + np.linalg.slogdet(normal)[1])

    def noise_of(self, r: Floats, by: Floats) -> ChainNoise:
        """Return the most likely noise of residuals (K,); `by` (K, P) is X, as in `deviance`."""
        size = _size(r[self.used])
        begin = np.log([0.5 * size, size])
        best = minimize(
            lambda p: self.deviance(_noise(p, size), r, by),
            begin,
            method="Nelder-Mead",
            options={"xatol": 1e-3, "fatol": 1e-3, "maxfev": 200},
        )
        return _noise(best.x, size)

    def noise_intervals(
        self, r: Floats, by: Floats, best: ChainNoise
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return (low, high) of `measured` and of `walk`: 95 % intervals by profile likelihood."""
        size = _size(r[self.used])
        least = self.deviance(best, r, by)

        def profile(which: int, value: float) -> float:
            def of(other: float) -> float:
                pair = (value, other) if which == 0 else (other, value)
                return self.deviance(_noise(np.array(pair), size), r, by)

            near = np.log(max((best.walk, best.measured)[which], LEAST * size))
            wide = minimize_scalar(
                of, bounds=(near - 8, near + 4), method="bounded", options={"xatol": 1e-2}
            )
            return min(float(wide.fun), of(np.log(LEAST * size))) - least

        def limit(which: int, sign: int) -> float:
            begin = np.log(max((best.measured, best.walk)[which], LEAST * size))
            inside, step = begin, 0.05
            while profile(which, inside + sign * step) < LIMIT:
                inside += sign * step
                step *= 2
                if inside < np.log(LEAST * size):
                    return 0.0
                if inside > begin + 40:
                    return np.inf
            found = root_scalar(
                lambda at: profile(which, at) - LIMIT,
                bracket=(inside, inside + sign * step),
                xtol=1e-3,
            )
            return float(np.exp(found.root))

        return (limit(0, -1), limit(0, 1)), (limit(1, -1), limit(1, 1))


def _size(r: Floats) -> float:
    return float(np.std(r)) + 1e-12 if r.size else 1.0


def _noise(logarithms: Floats, size: float) -> ChainNoise:
    measured, walk = np.exp(np.clip(logarithms, np.log(LEAST * size), np.log(size) + 20))
    return ChainNoise(float(measured), float(walk))
