"""Estimates the robots' poses and motion from the camera's frames and all directions sent.

Each robot i has a state that a Kalman filter follows from frame to frame: the position (x, y) and
the heading theta of its course, its turning rate a and speed v, a turn bias beta, a marker bias m
that is added to the measured heading, the flow (f_x, f_y) that carries the robot and, for a cell
that swims on a helix of angular frequency w, its sideways swing as sine p and cosine q. Under a
direction u

    dx/dt = v cos theta + f_x,  dy/dt = v sin theta + f_y,  dtheta/dt = a sin(u + beta - theta),
    dp/dt = w q,  dq/dt = -w p,

and a camera measures, each with its noise,

    x - p sin theta,  y + p cos theta,  theta + m + w q / v.

The state has the logarithms of a and v, and all parameters drift as random walks, so that old
measurements lose their weight.

A robot may not follow the latest direction. Its hypotheses, each with a filter and a weight, are
that it follows the latest direction, that it follows one of the two directions before, because
later ones were lost, and that it is stuck and stands still. A pose that fits no hypothesis is an
outlier; after some time without a fit, the filter restarts from the camera's pose.

The dead time tau, from the sending of a direction to the moment when it acts, is the same for all
robots. A bank has one filter for each tau of a grid, weighted by its likelihood; the grid is
refined around likely values. The filter uses frames about 30 ms apart, and each control step's
newest frame: wheels whose lag is not given respond over tens of milliseconds, and at shorter
intervals the start of the response would bias dead time and turning rate to smaller values. If the
lag T is given, turning rate and speed approach the commanded ones with the time constant T, and the
direction acts on the heading theta + T dtheta/dt, in which the robot would come to rest.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from tetractl.control.delay import Held
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.plan import Estimate
from tetractl.core.poses import Floats, Observation, Poses

GRID_STEP_S = 0.02  # initial spacing of the grid of dead times [s]
FINEST_S = 0.005  # a grid with this spacing or less is not refined further [s]
REACH = 3.0  # half width of the grid of dead times, in standard deviations of the prior
UNLIKELY = 25.0  # a dead time is dropped if its ln likelihood is below the best by more than this
KEPT = 64  # number of commands kept after they have acted
POSITION_NOISE_S = 0.005  # default deviation of a measured position, over the speed [s]
HEADING_NOISE = 0.01  # default deviation of a measured heading [rad]
SLIP = 0.02  # random walk of the position, over the speed [sqrt(s)]
WALK = 0.1  # initial random walk of the heading [rad/sqrt(s)]
DRIFTS = (0.01, 0.005, 0.005, 0.002)  # random walks of ln a, ln v, turn and marker bias [1/sqrt(s)]
SPACING_S = 0.03  # least time between two frames used [s]
FLOW_DRIFT = 0.05  # random walk of the flow, over its prior deviation [1/sqrt(s)]


class Prior(NamedTuple):
    """The prior on N robots: means and standard deviations.

    `a` (N,) [rad/s] and `speed` (N,) [length unit/s] have relative standard deviations, the dead
    time [s] an absolute one; the mean heading bias, marker bias [rad] and flow [length unit/s] are
    0. `position_noise` [length unit] and `heading_noise` [rad] are standard deviations of one
    measurement, 0 if unknown. The helix has a frequency [Hz] and a radius [length unit], which is 0
    if there is no helix. Wheels follow commands with a time constant `lag` [s], 0 for robots
    without wheels.
    """

    a: Floats
    speed: Floats
    dead_time: float
    a_std: float
    speed_std: float
    dead_time_std: float
    heading_bias_std: float
    marker_bias_std: float = 0.0
    flow_std: float = 0.0
    position_noise: float = 0.0
    heading_noise: float = 0.0
    helix_frequency: float = 0.0
    helix_radius: float = 0.0
    lag: float = 0.0

    def estimate(self) -> Estimate:
        """Return the prior's means as an estimate, with absolute standard deviations."""
        std = math.hypot(self.heading_bias_std, self.marker_bias_std)
        return Estimate(
            a=self.a,
            a_std=self.a_std * self.a,
            speed=self.speed,
            speed_std=self.speed_std * self.speed,
            heading_bias=np.zeros_like(self.a),
            heading_bias_std=np.full_like(self.a, std),
            dead_time=self.dead_time,
            dead_time_std=self.dead_time_std,
        )


def _kernel() -> Any:
    """Import and return the compiled filter: imported late, because checking a spec does not need
    it.
    """
    from tetractl.control.kernels import filter as kernel

    return kernel


class FilterBank:
    """The bank of filters that identifies N robots during one trial.

    With `drive_first`, robots drive a square before the first plan, and the filters start when the
    first direction acts.
    """

    def __init__(self, prior: Prior, drive_first: bool = False) -> None:
        kernel = _kernel()
        self.prior = prior
        self._drive_first = drive_first
        count = len(prior.a)
        noise = np.empty((3, count))
        noise[:2] = prior.position_noise or POSITION_NOISE_S * np.maximum(prior.speed, 1e-9)
        noise[2] = prior.heading_noise or HEADING_NOISE
        walk = np.zeros((kernel.SIZE, count))
        walk[:2], walk[2] = SLIP * prior.speed, WALK
        walk[3:7] = np.array(DRIFTS)[:, None]
        walk[5] *= prior.heading_bias_std > 0
        walk[6] *= prior.marker_bias_std > 0
        walk[7:9] = FLOW_DRIFT * prior.flow_std
        walk[9:11] = 0.1 * prior.helix_radius
        helix = 2 * math.pi * prior.helix_frequency if prior.helix_radius > 0 else 0.0
        self._model = kernel.FilterModel(prior.a, prior.speed, noise, walk, helix, prior.lag)
        self._when, self._u = np.empty(0), np.empty(0)  # send times [s], directions [rad]
        self._last: Observation | None = None  # the last frame used
        # time at which the filters start [ns]; None if it depends on the first direction
        self._from_ns: int | None = None if drive_first else 0
        self._turning = False  # whether robots have turned on the spot since the last direction
        self._noisy = False  # whether standing robots were measured at different poses
        low = max(0.0, prior.dead_time - REACH * prior.dead_time_std)
        high = prior.dead_time + REACH * prior.dead_time_std
        tau = np.arange(low, high + 1e-9, GRID_STEP_S)
        self._step = GRID_STEP_S
        self._bank = self._first_bank(tau)

    def _first_bank(self, tau: Floats):
        kernel, prior, count = _kernel(), self.prior, len(self.prior.a)
        size, slots = kernel.SIZE, kernel.SLOTS
        state = np.zeros((len(tau), count, slots, kernel.STATE))
        deviations = np.zeros(size)
        deviations[3:9] = (
            prior.a_std,
            prior.speed_std,
            prior.heading_bias_std,
            prior.marker_bias_std,
            prior.flow_std,
            prior.flow_std,
        )
        deviations[9:11] = prior.helix_radius / math.sqrt(2)
        cov = np.zeros((len(tau), count, slots, size, size))
        cov[..., range(size), range(size)] = deviations**2
        weight = np.full((len(tau), count, slots), -np.inf)
        weight[..., 0] = 0.0
        return kernel.Bank(
            state,
            cov,
            np.full((len(tau), count, slots), np.nan),
            weight,
            np.ones((len(tau), count, 2)),
            np.zeros((len(tau), count)),
            tau,
            -(((tau - prior.dead_time) / prior.dead_time_std) ** 2) / 2,
            np.zeros(len(tau), dtype=np.int64),
        )

    def sent(self, command: Command) -> None:
        """Add a direction or a stop with the time at which it was sent."""
        if command.field_off:
            return
        if not command.stops or command.facing is not None:
            self._turning = command.facing is not None
        when = command.sent_ns / SECOND
        if self._from_ns is None:
            settled = self.prior.dead_time + REACH * self.prior.dead_time_std
            self._from_ns = command.sent_ns + round(settled * SECOND)
        self._when = np.append(self._when, when)
        self._u = np.append(self._u, np.nan if command.direction is None else command.direction)
        done = int(self._bank.next.min())
        if done > KEPT:
            self._when, self._u = self._when[done:].copy(), self._u[done:].copy()
            self._bank.next[:] -= done

    def seen(self, observation: Observation, earlier: Sequence[Observation] = ()) -> None:
        """Update the filters by those `earlier` frames that are at least SPACING_S apart, and by
        the frame `observation`."""
        for frame in (*earlier, observation):
            least = 1 if earlier and frame is observation else round(SPACING_S * SECOND)
            if self._last is not None and frame.sampled_ns < self._last.sampled_ns + least:
                continue
            since = None if self._turning else self._from_ns
            if self._last is None or since is None or frame.sampled_ns < since:
                self._place(frame)
            else:
                self._follow(frame)
            self._last = frame
        self._select()

    def restart(self, robots: Iterable[int]) -> None:
        """Reset the filters of replaced robots to the new robots' poses in the last frame."""
        for i in robots:
            assert self._last is not None, "a robot can be replaced only after a frame"
            first = self._first_bank(self._bank.tau)
            for column, fresh in zip(self._bank[:6], first[:6], strict=True):
                column[:, i] = fresh[:, i]
            for b, following in enumerate(self._bank.next):
                if following:
                    self._bank.u[b, i] = self._u[following - 1]
                _kernel().place(self._bank, b, i, self._model, self._last.poses.array()[i])

    def _place(self, frame: Observation) -> None:
        """Set the poses to those of a frame, and let robots follow the last command that acts at
        or before the frame's exposure.
        """
        now, bank = frame.sampled_ns / SECOND, self._bank
        for i in range(len(self.prior.a)):
            pose = frame.poses.array()[i]
            for b in range(len(bank.tau)):
                _kernel().place(bank, b, i, self._model, pose)
        for b, tau in enumerate(bank.tau):
            acting = np.flatnonzero(self._when + tau <= now)
            if len(acting):
                bank.next[b] = acting[-1] + 1
                bank.u[b] = self._u[acting[-1]]

    def _follow(self, frame: Observation) -> None:
        assert self._last is not None
        last, now = self._last.poses.array(), frame.poses.array()
        same = (last == now).all(axis=1)
        if not len(self._when) and frame.valid.any() and not same.all():
            self._noisy = True
        frozen = len(same) > 1 and same.all()  # the camera has repeated its last frame
        # measurements with noise differ, so an equal pose is a repeated one
        seen = frame.valid & ~(same & (self._noisy | frozen))
        since, until = self._last.sampled_ns / SECOND, frame.sampled_ns / SECOND
        _kernel().follow(
            self._bank, self._model, self._step, since, until, self._when, self._u, now, seen
        )

    def _select(self) -> None:
        """Drop dead times that are unlikely, and refine the grid around those that are likely."""
        bank = self._bank
        score, best = bank.score, int(np.argmax(bank.score))
        kept = np.flatnonzero(score >= score[best] - UNLIKELY)
        low, high = max(0, min(kept[0], best - 1)), min(len(score) - 1, max(kept[-1], best + 1))
        if high - low + 1 < len(score):
            bank = self._bank = bank._make(column[low : high + 1] for column in bank)
            best -= low
        count = len(bank.tau)
        if count > 3 or self._when.size == 0:
            return
        finer = self._step > FINEST_S and count == 3
        if finer:
            self._step /= 2
        elif 0 < best < count - 1 or (best == 0 and bank.tau[0] == 0 and count > 1):
            return
        center = bank.tau[best]
        tau = center + self._step * np.arange(-1, 2)
        tau = np.maximum(tau, 0.0)
        tau = np.unique(tau)
        self._bank = self._around(best, tau)

    def _around(self, best: int, tau: Floats):
        """Return a bank with the dead times `tau` [s]. Each filter is a copy of the filter
        with the nearest dead time in the present bank.
        """
        bank = self._bank
        source = [int(np.argmin(np.abs(bank.tau - one))) for one in tau]
        made = bank._make(np.ascontiguousarray(column[source]) for column in bank)
        made.score[:] = np.interp(tau, bank.tau, bank.score)
        return made._replace(tau=tau)

    def dead_time(self) -> tuple[float, float]:
        """Return the dead time and its standard deviation [s]."""
        bank = self._bank
        weight = np.exp(bank.score - bank.score.max())
        weight /= weight.sum()
        mean = float(weight @ bank.tau)
        return mean, math.sqrt(float(weight @ (bank.tau - mean) ** 2) + (self._step / 4) ** 2)

    def _likely(self) -> tuple[int, Floats, Floats, Floats]:
        """Return the index of the likeliest filter and, of each robot's likeliest hypothesis in it,
        the state (N, STATE), the covariance (N, SIZE, SIZE) and the direction (N,) [rad].
        """
        bank = self._bank
        best = int(np.argmax(bank.score))
        slots = np.argmax(bank.weight[best], axis=1)
        each = np.arange(len(slots))
        return (
            best,
            bank.state[best, each, slots],
            bank.cov[best, each, slots],
            bank.u[best, each, slots],
        )

    def estimate(self) -> Estimate:
        """Return the parameters of the robots and their standard deviations."""
        _, z, cov, _ = self._likely()
        std = np.sqrt(np.maximum(cov[:, range(11), range(11)], 0.0))
        a, speed = self.prior.a * np.exp(z[:, 3]), self.prior.speed * np.exp(z[:, 4])
        tau, tau_std = self.dead_time()
        of_bias = cov[:, 5, 5] + cov[:, 6, 6] + 2 * cov[:, 5, 6]
        return Estimate(
            a=a,
            a_std=a * std[:, 3],
            speed=speed,
            speed_std=speed * std[:, 4],
            heading_bias=z[:, 5] + z[:, 6],
            heading_bias_std=np.sqrt(np.maximum(of_bias, 0.0)),
            dead_time=tau,
            dead_time_std=tau_std,
        )

    def course(self) -> tuple[Poses, Floats, Floats]:
        """Return position and heading of each robot's course at the last frame, the turn biases
        (N,) [rad] and the flow (N, 2) [length unit/s]."""
        _, z, _, _ = self._likely()
        return Poses.of(z[:, :3]), z[:, 5].copy(), z[:, 7:9].copy()

    def rests(self, until: int) -> Poses:
        """Return the poses in which robots stopped at `until` [ns] would come to rest."""
        _, z, _, _ = self._likely()
        held = self.held(until)
        seconds = np.array([end - begin for begin, end, _ in held]) / SECOND
        _kernel().drive(self._model, z, np.array([u for _, _, u in held]), seconds)
        return Poses.of(z[:, :3])

    def held(self, until: int) -> list[Held]:
        """Return the directions that act from the last frame to a time [ns], oldest first."""
        assert self._last is not None
        best, _, _, u = self._likely()
        stuck = np.argmax(self._bank.weight[best], axis=1) == _kernel().STUCK
        tau, begin, found = self.dead_time()[0], self._last.sampled_ns, []
        for when, direction in zip(self._when, self._u, strict=True):
            acts = round((when + tau) * SECOND)
            if acts <= self._last.sampled_ns or acts > until:
                continue
            found.append((begin, acts, u))
            begin, u = acts, np.where(stuck, np.nan, direction)
        found.append((begin, until, u))
        return found


def warm_up(prior: Prior, starts: Poses) -> None:
    """Compile the functions of a filter bank, or load them from the cache."""
    bank, valid = FilterBank(prior), np.ones(len(prior.a), dtype=np.bool_)
    for k, now in enumerate((0, round(SPACING_S * SECOND))):
        bank.seen(Observation(k, now, now, starts, valid))
