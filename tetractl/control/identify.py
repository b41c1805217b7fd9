"""Maximum-a-posteriori fit of dead time, turning rates, speeds and heading biases to a trial.

Of N robots, K intervals between two camera frames are known, and C directions with the times when
they were decided. Direction c acts from when_c + tau on, with one dead time tau for all robots. A
robot at the heading theta_k turns towards u + beta_i, with its heading bias beta_i, at a rate of
a_i: the model of the motion predicts its turn Delta_ki(tau, a_i, beta_i). With the residuals

    r_ki = turn measured - Delta_ki,       sigma_k^2 = s^2 (2 HEADING_STD^2 + HEADING_WALK^2 t_k)

of an interval of t_k seconds, the fit is the least of

    sum_ki C^2/2 ln(1 + r_ki^2 / (C sigma_k)^2) + the priors' squares / 2

over tau, ln a_i and beta_i, with normal priors: Cauchy's function, so that a command that a robot
lost counts for little. The scale s is the median of |r| / 0.6745 sigma of the fit before. The
directions are those sent, not those believed to have arrived: every command lost would look like
one more control period of dead time.

The function has several minima by tau. While its deviation is above SURE_S, and again whenever the
number of intervals has doubled, tau is looked for on a grid, with a and beta fitted at each of its
points; then a few Gauss-Newton steps of iteratively reweighted least squares follow, and the
deviations are those of the last step's normal equations.

The speed follows separately, by the same function, from the distances |d_ki| of the intervals,
|d_ki| = v_i t_k sinc(turn measured / 2): the chord of a steady turn, whatever the direction was.

The controller runs the compiled twin of this fit, `tetractl.control.kernels.identify`, which must
agree with it; logs, with their many intervals, are fitted by this one.

Source of the weights: Holland and Welsch, "Robust regression using iteratively reweighted
least-squares", Communications in Statistics A6 (1977).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetractl.core.plan import Estimate
from tetractl.core.poses import Bools, Floats, wrap
from tetractl.model.motion.base import TurnFunction

HEADING_STD = 0.01  # of a measured heading [rad] ...
HEADING_WALK = 0.1  # ... and of its random walk [rad/sqrt(s)], before anything is seen
TRAVEL_STD = 0.01  # of a measured distance, in seconds of travel [s]
CAUCHY = 2.385  # C: 95 % of the efficiency of least squares where no residual is an outlier
FACTOR_MAX = 5.0  # a and speed stay within this factor of the prior's
LN_FACTOR_MAX = float(np.log(FACTOR_MAX))
SURE_S = 0.012  # deviation of the dead time from which on no grid is looked at [s]
GRID_STEP_S = 0.02
LOOK_LEAST = 8  # intervals from which on their doubling is a reason to look again
LOOK_MAX = 80  # intervals that a look over the grid takes into account at most, the latest
NUDGE_S, NUDGE = 0.002, 1e-4  # of tau [s], ln a and beta, for derivatives
SCALE_WEIGHT = 20  # residuals that the scale before anything is seen counts for


class Prior(NamedTuple):
    """What is known of N robots before a trial: means and standard deviations.

    `a` (N,) [rad/s] and `speed` (N,) [length unit/s] with relative deviations, dead time [s]; the
    mean heading bias is 0 [rad].
    """

    a: Floats
    speed: Floats
    dead_time: float
    a_std: float
    speed_std: float
    dead_time_std: float
    heading_bias_std: float

    def estimate(self) -> Estimate:
        """Return the prior as an estimate from no data."""
        return Estimate(
            a=self.a,
            a_std=self.a_std * self.a,
            speed=self.speed,
            speed_std=self.speed_std * self.speed,
            heading_bias=np.zeros_like(self.a),
            heading_bias_std=np.full_like(self.a, self.heading_bias_std),
            dead_time=self.dead_time,
            dead_time_std=self.dead_time_std,
        )


class Intervals(NamedTuple):
    """K intervals between two camera frames of N robots.

    `since`, `until` (K,) [s]; `heading` (K, N) at `since` [rad]; `turned` (K, N) [rad] and
    `travelled` (K, N) [length unit] until `until`; `usable` (K, N) is False where nothing is to be
    learnt: a robot that was not tracked, or did not move yet.
    """

    since: Floats
    until: Floats
    heading: Floats
    turned: Floats
    travelled: Floats
    usable: Bools

    def part(self, kept: slice) -> "Intervals":
        """Return the intervals of a slice."""
        return Intervals._make(column[kept] for column in self)


class Directions(NamedTuple):
    """C directions u (C,) [rad], and the times `when` (C,) [s] of the frames they answer."""

    when: Floats
    u: Floats


def fit(
    intervals: Intervals,
    directions: Directions,
    prior: Prior,
    guess: Estimate,
    turn: TurnFunction,
    iterations: int = 2,
) -> Estimate:
    """Return the fit, from the guess of an earlier fit of fewer data or from the prior's estimate.

    `turn` is the motion's. Without intervals it is the guess.
    """
    if not len(intervals.since) or not len(directions.u):
        return guess
    turns = _Turns(intervals, directions, prior, turn)
    tau, ln_a, beta = guess.dead_time, np.log(guess.a / prior.a), guess.heading_bias
    assert tau is not None and beta is not None and guess.dead_time_std is not None
    near: Floats | None = turns.near(tau, ln_a, beta)
    scale = turns.scale(near[0])
    count = len(intervals.since)
    doubled = count >= LOOK_LEAST and count & (count - 1) == 0
    if guess.dead_time_std > SURE_S or doubled:
        some = _Turns(intervals.part(slice(-LOOK_MAX, None)), directions, prior, turn)
        tau, ln_a, beta = some.look(tau, scale)
        near = None
    std = np.zeros(0)
    for _ in range(iterations):
        near = turns.near(tau, ln_a, beta) if near is None else near
        tau, ln_a, beta, std = turns.improve(tau, ln_a, beta, scale, near)
        near = None
    count = len(prior.a)
    a = prior.a * np.exp(ln_a)
    speed, speed_std = _fit_speed(intervals, prior, guess.speed)
    return Estimate(
        a=a,
        a_std=std[1 : 1 + count] * a,
        speed=speed,
        speed_std=speed_std,
        heading_bias=beta,
        heading_bias_std=std[1 + count :],
        dead_time=tau,
        dead_time_std=float(std[0]),
    )


class _Turns:
    """The turns of K intervals and what the model predicts of them."""

    def __init__(
        self, intervals: Intervals, directions: Directions, prior: Prior, turn: TurnFunction
    ) -> None:
        self.intervals, self.directions = intervals, directions
        self.prior, self.turn = prior, turn
        t = intervals.until - intervals.since
        self.sigma = np.sqrt(2 * HEADING_STD**2 + HEADING_WALK**2 * t)[:, None]
        self.tau_max = prior.dead_time + 4 * prior.dead_time_std

    def acting(self, tau: Floats) -> list[tuple[Floats, Floats]]:
        """Return the `pieces` for tau (T,)."""
        return pieces(self.intervals, self.directions, tau)

    def residuals(self, acting: list[tuple[Floats, Floats]], ln_a: Floats, beta: Floats) -> Floats:
        """Return r (T, K, N) for what is `acting` by T dead times, and ln a and beta (T, N), over
        the unscaled sigma."""
        now = headings = self.intervals.heading
        a = (self.prior.a * np.exp(ln_a))[:, None, :]
        for u, seconds in acting:
            towards, t = u[..., None] + beta[:, None, :], seconds[..., None]
            now = np.where(t > 0, self.turn(now, towards, a, t), now)
        missed = wrap(self.intervals.turned - (now - headings))
        return np.where(self.intervals.usable, missed / self.sigma, 0.0)

    def near(self, tau: float, ln_a: Floats, beta: Floats) -> Floats:
        """Return residuals (5, K, N): there, with more ln a, less tau, more tau, more beta."""
        three = np.array([tau, max(0.0, tau - NUDGE_S), tau + NUDGE_S])
        alphas, betas = np.repeat(ln_a[None], 5, 0), np.repeat(beta[None], 5, 0)
        alphas[1] += NUDGE
        betas[4] += NUDGE
        which = [0, 0, 1, 2, 0]
        acting = [(u[which], seconds[which]) for u, seconds in self.acting(three)]
        return self.residuals(acting, alphas, betas)

    def scale(self, residuals: Floats) -> float:
        """Return s from the median of residuals (K, N), shrunk towards 1 while they are few."""
        found = np.abs(residuals)[self.intervals.usable]
        if not found.size:
            return 1.0
        median = float(np.median(found)) / 0.6745
        total = SCALE_WEIGHT + found.size
        return max(0.02, float(np.sqrt((SCALE_WEIGHT + found.size * median**2) / total)))

    def look(self, tau: float, scale: float) -> tuple[float, Floats, Floats]:
        """Return the best of a grid of dead times, with a and beta fitted at each."""
        prior = self.prior
        low = max(0.0, prior.dead_time - 3 * prior.dead_time_std)
        grid = np.arange(low, prior.dead_time + 3 * prior.dead_time_std + 1e-9, GRID_STEP_S)
        grid = np.append(grid, tau)
        acting = self.acting(grid)
        ln_a = np.zeros((len(grid), len(prior.a)))
        beta = np.zeros_like(ln_a)
        for _ in range(3):
            r, by_a, by_beta = self._linearise(acting, ln_a, beta, scale)
            w = _weights(r)
            # a 2 x 2 system for each dead time and robot
            aa = (w * by_a * by_a).sum(1) + prior.a_std**-2
            bb = (w * by_beta * by_beta).sum(1) + prior.heading_bias_std**-2
            ab = (w * by_a * by_beta).sum(1)
            ga = (w * by_a * r).sum(1) - ln_a / prior.a_std**2
            gb = (w * by_beta * r).sum(1) - beta / prior.heading_bias_std**2
            det = aa * bb - ab * ab
            ln_a = _bounded(ln_a + _within((bb * ga - ab * gb) / det, 0.3))
            beta = beta + _within((aa * gb - ab * ga) / det, 0.3)
        r = self.residuals(acting, ln_a, beta) / scale
        total = CAUCHY**2 / 2 * np.log1p((r / CAUCHY) ** 2).sum(axis=(1, 2))
        total += ((grid - prior.dead_time) / prior.dead_time_std) ** 2 / 2
        total += (ln_a**2).sum(1) / prior.a_std**2 / 2
        total += (beta**2).sum(1) / prior.heading_bias_std**2 / 2
        best = int(np.argmin(total))
        return float(grid[best]), ln_a[best], beta[best]

    def improve(
        self, tau: float, ln_a: Floats, beta: Floats, scale: float, near: Floats
    ) -> tuple[float, Floats, Floats, Floats]:
        """Do a Gauss-Newton step, by the residuals near the point; return tau, ln a, beta and the
        deviations of all (1 + 2 N,)."""
        prior, count = self.prior, len(self.prior.a)
        low, high = max(0.0, tau - NUDGE_S), tau + NUDGE_S
        base, by_a, less, more, by_beta = near / scale
        by_tau, by_a, by_beta = (
            (less - more) / (high - low),
            (base - by_a) / NUDGE,
            (base - by_beta) / NUDGE,
        )
        w = _weights(base)
        normal = np.zeros((1 + 2 * count, 1 + 2 * count))
        normal[0, 0] = (w * by_tau**2).sum() + prior.dead_time_std**-2
        at_a, at_beta = slice(1, 1 + count), slice(1 + count, 1 + 2 * count)
        normal[0, at_a] = normal[at_a, 0] = (w * by_tau * by_a).sum(0)
        normal[0, at_beta] = normal[at_beta, 0] = (w * by_tau * by_beta).sum(0)
        normal[at_a, at_a] = np.diag((w * by_a**2).sum(0) + prior.a_std**-2)
        normal[at_beta, at_beta] = np.diag((w * by_beta**2).sum(0) + prior.heading_bias_std**-2)
        normal[at_a, at_beta] = normal[at_beta, at_a] = np.diag((w * by_a * by_beta).sum(0))
        right = np.concatenate(
            [
                [(w * by_tau * base).sum() - (tau - prior.dead_time) / prior.dead_time_std**2],
                (w * by_a * base).sum(0) - ln_a / prior.a_std**2,
                (w * by_beta * base).sum(0) - beta / prior.heading_bias_std**2,
            ]
        )
        inverse = np.linalg.inv(normal)
        change = inverse @ right
        tau = min(max(tau + min(max(float(change[0]), -0.03), 0.03), 0.0), self.tau_max)
        ln_a = _bounded(ln_a + _within(change[at_a], 0.3))
        beta = beta + _within(change[at_beta], 0.3)
        return tau, ln_a, beta, np.sqrt(inverse.diagonal())

    def _linearise(
        self, acting: list[tuple[Floats, Floats]], ln_a: Floats, beta: Floats, scale: float
    ) -> tuple[Floats, Floats, Floats]:
        """Return r over sigma, and minus its derivatives by ln a and by beta; (T, K, N) each."""
        base = self.residuals(acting, ln_a, beta) / scale
        by_a = (base - self.residuals(acting, ln_a + NUDGE, beta) / scale) / NUDGE
        by_beta = (base - self.residuals(acting, ln_a, beta + NUDGE) / scale) / NUDGE
        return base, by_a, by_beta


def _weights(r: Floats) -> Floats:
    """Return Cauchy's weights of residuals over their sigma."""
    return 1 / (1 + (r / CAUCHY) ** 2)


def _bounded(ln_a: Floats) -> Floats:
    return _within(ln_a, LN_FACTOR_MAX)


def _within(values: NDArray[np.floating[Any]], most: float) -> Floats:
    """Return the values brought into [-most, most], with less overhead than `np.clip`."""
    return np.minimum(np.maximum(values, -most), most)


def pieces(
    intervals: Intervals, directions: Directions, tau: Floats
) -> list[tuple[Floats, Floats]]:
    """Return the directions that act in each interval, oldest first, for T dead times.

    Each is a pair of u (T, K) [rad] and the seconds (T, K) for which it acts, 0 where there are
    fewer. Before the first direction acts, it is taken as acting.
    """
    since, until = intervals.since, intervals.until
    last = directions.u.size - 1
    acting = np.full((len(tau), last + 2), np.inf)  # the last acts for ever
    acting[:, :-1] = directions.when + tau[:, None]
    first = np.empty((len(tau), since.size), dtype=np.int64)
    count = 1
    for row, at in enumerate(acting[:, :-1]):
        first[row] = np.maximum(at.searchsorted(since, "right") - 1, 0)
        after = at.searchsorted(until, "left") - 1
        count = max(count, int((after - first[row]).max(initial=0)) + 1)
    found: list[tuple[Floats, Floats]] = []
    each, begin = np.arange(len(tau))[:, None], since
    for piece in range(count):
        index = np.minimum(first + piece, last)
        end = np.minimum(acting[each, index + 1], until)
        found.append((directions.u[index], np.maximum(end - begin, 0.0)))
        begin = np.maximum(begin, end)
    return found


def _fit_speed(intervals: Intervals, prior: Prior, speed: Floats) -> tuple[Floats, Floats]:
    """Return the speeds and their deviations, from distances and measured turns."""
    t = (intervals.until - intervals.since)[:, None]
    by_speed = t * np.sinc(intervals.turned / (2 * np.pi))
    usable = intervals.usable & (np.abs(intervals.turned) < np.pi / 2)
    by_speed = np.where(usable, by_speed, 0.0)
    sigma = TRAVEL_STD * prior.speed
    prior_var = (prior.speed_std * prior.speed) ** 2 + 1e-300
    var = prior_var
    for _ in range(2):
        r = np.where(usable, intervals.travelled - by_speed * speed, 0.0) / (sigma + 1e-300)
        w = _weights(r) / (sigma**2 + 1e-300)
        var = 1 / ((w * by_speed**2).sum(0) + 1 / prior_var)
        right = (w * by_speed * np.where(usable, intervals.travelled, 0.0)).sum(0)
        speed = var * (right + prior.speed / prior_var)
    low, high = prior.speed / FACTOR_MAX, prior.speed * FACTOR_MAX
    return np.clip(speed, low, high), np.sqrt(var)
